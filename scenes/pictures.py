"""PNG and JPEG as linear Rec. 709: by what the file says of its values, its colours and its upper side, or refused.

PNG says it in chunks, of which the first of cICP, iCCP, sRGB, gAMA with cHRM counts (PNG, third edition, 4.3), JPEG in
a profile; what says nothing is sRGB. A picture that is stored turned is refused: programs disagree on whether to turn
it.
"""

import io
import struct
import warnings
from typing import Literal

import numpy as np
import PIL.ExifTags
import PIL.Image
import PIL.ImageCms

from termwise.scenes import srgb
from termwise.scenes.images.image import REC709, in_rec709

Encoding = Literal["sRGB", "linear"]

KINDS = {b"\x89PNG": "PNG", b"\xff\xd8\xff": "JPEG"}
"""By the first bytes of a file."""
_D65, _C = REC709[6:], (0.310, 0.316)
_PRIMARIES = {
    1: REC709,
    4: (0.67, 0.33, 0.21, 0.71, 0.14, 0.08, *_C),
    5: (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *_D65),
    6: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *_D65),
    7: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *_D65),
    8: (0.681, 0.319, 0.243, 0.692, 0.145, 0.049, *_C),
    9: (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *_D65),
    10: (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3),
    11: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351),
    12: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *_D65),
    22: (0.630, 0.340, 0.295, 0.605, 0.155, 0.077, *_D65),
}
"""Chromaticities x, y of red, green, blue and white by number (ITU-T H.273, table 2)."""
_TRANSFERS: dict[int, Encoding] = {8: "linear", 13: "sRGB"}
"""Those of H.273, table 3, of which a value has one meaning: others are those of cameras, of films and of HDR."""
_GAMMAS: dict[float, Encoding] = {0.45455: "sRGB", 1.0: "linear"}
"""What the chunk gAMA means; programs write the first for sRGB's curve, to which it is near."""
_SAY = "to say the encoding, 'sRGB' or 'linear'"
_NEAR = 2
"""Of 255: how far a profile may take values of sRGB; there are many profiles of it, each rounded in its way."""
_ADOBE = "R03"
"""What EXIF calls the colours of Adobe RGB (DCF 2.0)."""


def is_picture(begins: bytes) -> bool:
    """Whether the first bytes of a file are those of PNG or JPEG."""
    return begins.startswith((*KINDS,))


def read(content: bytes, encoding: Encoding | None, *, opaque: bool = True) -> np.ndarray:
    """Linear values (H, W, 3) float32 of a picture, in [0, 1] where it has no colours beyond Rec. 709's.

    Parameters
    ----------
    content : the whole file.
    encoding : what its values are, of Rec. 709, whatever it says itself; None: what it says.
    opaque : whether transparent pixels are refused; else what it says of them is left out.

    Raises
    ------
    ValueError : what is wrong, without the file's name.
    """
    kind = next((name for magic, name in KINDS.items() if content.startswith(magic)), None)
    if kind is None:
        raise ValueError(f"begins with {content[:4]!r}: allowed are {' and '.join(KINDS.values())}")
    try:
        with warnings.catch_warnings(), PIL.Image.open(io.BytesIO(content), formats=[kind]) as image:
            warnings.simplefilter("ignore", PIL.Image.DecompressionBombWarning)
            image.load()  # of PNG some chunks stand behind the pixels
            _refuse_turned(image)
            colors = REC709
            if encoding is None:
                encoding, colors = _said(image, _chunk(content, b"cICP") if kind == "PNG" else None)
            values = _shares(image, kind == "PNG" and content[24:25] == b"\x10", opaque=opaque)
    except (OSError, SyntaxError, PIL.Image.DecompressionBombError) as error:
        raise ValueError(f"cannot be read: {' '.join(str(error).split())}") from None
    linear = srgb.decoded(values) if encoding == "sRGB" else values
    return in_rec709("its colours", linear, colors)[0].astype(np.float32)


def _shares(image: PIL.Image.Image, wide: bool, *, opaque: bool) -> np.ndarray:
    """Values (H, W, 3) in [0, 1]; `wide`: of 16 bits, `opaque`: what is not is refused."""
    if image.has_transparency_data:
        if opaque and np.asarray(image.convert("RGBA"))[..., 3].min() < 255:
            raise ValueError("holds transparent texels, and a surface is opaque: allowed is an image without")
    elif image.mode not in ("1", "L", "P", "RGB", "I;16"):
        raise ValueError(f"holds {image.mode}: allowed are grey and RGB")
    if image.mode == "I;16":
        return np.repeat(np.asarray(image, np.float64)[..., None] / 65535.0, 3, axis=2)
    if wide:
        raise ValueError("holds colours of 16 bits, which would be cut to 8: write OpenEXR, or 8 bits")
    return np.asarray(image.convert("RGB"), np.float64) / 255.0


def _refuse_turned(image: PIL.Image.Image) -> None:
    """Refuse a picture whose first row is not its upper one, by EXIF or XMP."""
    turned = _exif(image).get(PIL.ExifTags.Base.Orientation, 1)
    if turned != 1:
        raise ValueError(
            f"is stored turned (EXIF: orientation {turned}), and programs disagree on whether to turn it: write it "
            "upright, with orientation 1 or none"
        )


def _exif(image: PIL.Image.Image) -> PIL.Image.Exif:
    """What a picture says by EXIF; nothing where that is damaged, as other programs have it."""
    try:
        return image.getexif()
    except (SyntaxError, ValueError, KeyError, struct.error):
        return PIL.Image.Exif()


def _said(image: PIL.Image.Image, code_points: bytes | None) -> tuple[Encoding, tuple[float, ...]]:
    """Encoding and chromaticities that a picture says; those of sRGB where it says nothing."""
    info = image.info
    if code_points is not None:
        return _coded(code_points)
    if profile := info.get("icc_profile"):
        _refuse_profile(profile)
        return "sRGB", REC709
    if "srgb" in info:
        return "sRGB", REC709
    if _exif(image).get_ifd(PIL.ExifTags.IFD.Interop).get(1) == _ADOBE:
        raise ValueError(f"is of Adobe RGB, by its EXIF: allowed is sRGB, or {_SAY}")
    gamma = info.get("gamma", 0.45455)
    if gamma not in _GAMMAS:
        raise ValueError(f"says that its gamma is {gamma:g}: allowed is {_SAY}")
    white, primaries = np.split(np.array(info.get("chromaticity", (*_D65, *REC709[:6]))), [2])
    return _GAMMAS[gamma], (*primaries.tolist(), *white.tolist())


def _coded(code_points: bytes) -> tuple[Encoding, tuple[float, ...]]:
    """What the chunk cICP says: primaries, transfer, matrix and range by numbers of H.273."""
    said = "-".join(map(str, code_points))
    if len(code_points) != 4 or code_points[2:] != b"\0\1":
        raise ValueError(f"says cICP {said}: allowed are four numbers, the last two 0 and 1: RGB in its full range")
    primaries, transfer = code_points[:2]
    if transfer not in _TRANSFERS or primaries not in _PRIMARIES:
        raise ValueError(
            f"says cICP {said}: allowed is a transfer, the second, of 13 (sRGB) or 8 (linear), of primaries, the "
            f"first, of {', '.join(map(str, _PRIMARIES))}; or {_SAY}"
        )
    return _TRANSFERS[transfer], _PRIMARIES[primaries]


def _refuse_profile(profile: bytes) -> None:
    """Refuse a profile that is not sRGB's, whatever its name: one of its values is elsewhere."""
    steps = np.arange(0, 256, 15, dtype=np.uint8)
    try:
        there = PIL.ImageCms.ImageCmsProfile(io.BytesIO(profile))
        name = PIL.ImageCms.getProfileDescription(there).strip()
        grey = there.profile.xcolor_space.strip() == "GRAY"
        colors = steps[:, None] if grey else np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        given = PIL.Image.fromarray(colors[:, 0][None] if grey else colors[None])
        transform = PIL.ImageCms.buildTransform(
            there, PIL.ImageCms.createProfile("sRGB"), given.mode, "RGB", PIL.ImageCms.Intent.RELATIVE_COLORIMETRIC
        )
        shown = np.asarray(PIL.ImageCms.applyTransform(given, transform), np.int64)[0]
    except (PIL.ImageCms.PyCMSError, OSError, TypeError, ValueError) as error:
        raise ValueError(
            f"has a profile that cannot be read ({' '.join(str(error).split())}): allowed is sRGB, or {_SAY}"
        ) from None
    if np.abs(shown - colors).max() > _NEAR:
        raise ValueError(f"is of the profile {name!r}: allowed is sRGB, or {_SAY}")


def _chunk(content: bytes, wanted: bytes) -> bytes | None:
    """The data of a chunk of PNG that stands before the pixels; None without."""
    at = 8
    while at + 8 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, at)
        if kind == wanted:
            return content[at + 8 : at + 8 + length]
        if kind == b"IDAT":
            return None
        at += length + 12
    return None
