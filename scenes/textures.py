"""Images over a surface: a value at (u, v), bilinear between texel centres at ((i + 0.5) / W, 1 - (j + 0.5) / H).

(0, 0) is the lower left corner of the image and v goes up, as in OBJ; row j = 0 is the top one. Beyond [0, 1] the
image repeats, or its border goes on. Texels are float32, as both renderers have them, and nothing is filtered
beforehand: a sample is the value at one point.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import attrs
import numpy as np

from termwise.scenes import images, pictures, srgb
from termwise.scenes.pictures import Encoding

Wrap = Literal["repeat", "clamp"]
Channel = Literal["R", "G", "B"]

ALLOWED = f"PNG, JPEG, {images.ALLOWED}"


def _texels(values: Any) -> np.ndarray:
    with np.errstate(over="ignore"):  # what is not finite is refused by whoever knows the range
        texels = np.array(values, np.float32, order="C")
    if texels.ndim == 2:
        texels = texels[..., None]
    if texels.ndim != 3 or texels.shape[2] not in (1, 3) or 0 in texels.shape:
        raise ValueError(
            f"texels of the shape {np.shape(values)}: allowed are (height, width) and (height, width, 1 or 3)"
        )
    texels.flags.writeable = False
    return texels


def _wrap(_instance: Any, attribute: Any, value: Any) -> None:
    if value not in ("repeat", "clamp"):
        raise ValueError(f"{attribute.name} = {value!r}: allowed are 'repeat' and 'clamp'")


def _of_channels(reduce: Callable[..., np.ndarray]) -> Any:
    """The least or the greatest of each channel; NaN where a texel is."""
    # Axis by axis, for over both at once it takes 25 times as long.
    of = attrs.Factory(lambda self: tuple(reduce(reduce(self.texels, axis=0), axis=0).tolist()), takes_self=True)
    return attrs.field(init=False, eq=False, repr=False, default=of)


@attrs.frozen
class Texture:
    """An image in the place of a number or a colour of a material, or of a radiance; equal where its content is.

    Attributes
    ----------
    texels : (H, W, C) float32, C 1 for a number and 3 for a colour; linear, top row first. (H, W) is taken too.
    wrap : beyond [0, 1] "repeat", or "clamp": the border goes on.
    low, high : the least and the greatest value of each channel: between texels there is nothing beyond.
    content : sha256 of the texels.
    """

    texels: np.ndarray = attrs.field(
        converter=_texels, eq=False, repr=lambda texels: f"<{texels.shape[1]} x {texels.shape[0]}>"
    )
    wrap: Wrap = attrs.field(default="repeat", validator=_wrap)  # type: ignore[assignment]
    low: tuple[float, ...] = _of_channels(np.min)
    high: tuple[float, ...] = _of_channels(np.max)
    content: str = attrs.field(
        init=False,
        repr=False,
        default=attrs.Factory(
            lambda self: hashlib.sha256(repr(self.texels.shape).encode() + self.texels.data).hexdigest(),
            takes_self=True,
        ),
    )

    @property
    def channels(self) -> int:
        """1 or 3."""
        return self.texels.shape[2]

    def near(self, places: np.ndarray) -> np.ndarray:
        """The texels (..., C) that places (..., 2) lie in."""
        shares = places - np.floor(places) if self.wrap == "repeat" else np.clip(places, 0.0, 1.0)
        height, width, _ = self.texels.shape
        column = np.minimum((shares[..., 0] * width).astype(np.int64), width - 1)
        row = np.minimum(((1.0 - shares[..., 1]) * height).astype(np.int64), height - 1)
        return self.texels[row, column]

    def beyond(self, within: Callable[[np.ndarray], np.ndarray]) -> str | None:
        """The first texel that is not `within`, in words; None where all are."""
        bad = np.argwhere(~within(self.texels))
        if not len(bad):
            return None
        row, column, _ = bad[0]
        return f"texel {self.texels[row, column].tolist()} in row {row}, column {column}"


def of_two_at_least(texels: np.ndarray) -> np.ndarray:
    """The same image of two rows and columns at least: Mitsuba resamples one of fewer."""
    for axis in range(2):
        texels = np.repeat(texels, 2, axis=axis) if texels.shape[axis] == 1 else texels
    return texels


def in_color(texels: np.ndarray) -> np.ndarray:
    """Texels (H, W, 3), of numbers as grey."""
    return np.broadcast_to(texels, (*texels.shape[:2], 3))


def downwards(uv: np.ndarray) -> np.ndarray:
    """Places (..., 2) in an image where v goes down from the top row, as Mitsuba and glTF have it; and back."""
    return uv * (1.0, -1.0) + (0.0, 1.0)


def read_color(path: Path, encoding: Encoding | None) -> np.ndarray:
    """Linear texels (H, W, 3) float32 of an image.

    Parameters
    ----------
    path : of a file of `ALLOWED`.
    encoding : what its values are, of Rec. 709; None: what the file says, sRGB for whole numbers of which it says
        nothing, and linear floats.

    Raises
    ------
    ValueError : what is wrong, without the file's name.
    """
    try:
        with path.open("rb") as file:
            begins = file.read(8)
        if pictures.is_picture(begins):
            return pictures.read(path.read_bytes(), encoding)
        return _linear(images.read_one(path).pixels, encoding or "linear")
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise ValueError(str(error).removeprefix(f"{path}: ").replace(images.ALLOWED, ALLOWED)) from None


def read_number(path: Path, encoding: Encoding | None, channel: Channel | None) -> np.ndarray:
    """Texels (H, W) float32 of a grey image, or of one channel; whole numbers are linear unless `encoding` says not.

    Raises
    ------
    ValueError : as `read_color`; for an image of colours without a channel.
    """
    values = read_color(path, encoding or "linear")
    if channel is None and not np.array_equal(values, np.repeat(values[..., :1], 3, axis=2), equal_nan=True):
        raise ValueError("holds colours: allowed is a grey image, or a channel of it, 'R', 'G' or 'B'")
    return values[..., "RGB".index(channel or "R")]


def read_within(content: bytes, encoding: Encoding) -> np.ndarray:
    """Linear texels (H, W, 3) float32 of a PNG or JPEG that stands in another file; what it says of alpha is left out.

    Raises
    ------
    ValueError : as `read_color`.
    """
    return pictures.read(content, encoding, opaque=False)


def _linear(values: np.ndarray, encoding: Encoding) -> np.ndarray:
    if encoding == "linear":
        return values.astype(np.float32)
    with np.errstate(invalid="ignore"):  # of NaN, and of what is below 0
        return srgb.decoded(values.astype(np.float64)).astype(np.float32)
