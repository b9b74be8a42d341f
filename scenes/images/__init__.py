"""Linear images from files, whatever renderer wrote them: read rightly, or refused in a line.

A file is known by its first bytes, not by its name: OpenEXR, NumPy's NPY and NPZ, PFM, Radiance HDR, float TIFF. What
comes out is linear Rec. 709 over the display window; what had to be done for that is said in notes. What cannot be read
as it was meant (deep, subsampled, 8-bit, primaries of an unknown white, cut short) is a ValueError of one line.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import attrs
import numpy as np

from termwise.scenes.images import npy, openexr, pfm, radiance, tiff
from termwise.scenes.images.image import GREY, LOSSY, Image, Window

__all__ = ["LOSSY", "SUFFIXES", "Image", "Replicates", "Window", "read", "read_one", "replicates"]

SUFFIXES = (".exr", ".npy", ".npz", ".pfm", ".hdr", ".tif", ".tiff")
"""Of the files that are taken from a folder, in lower case."""
ALLOWED = "OpenEXR, NPY, NPZ, PFM, Radiance HDR, float TIFF"

_READERS: dict[bytes, Callable[[Path, str | None], list[Image]]] = {
    b"\x76\x2f\x31\x01": openexr.read,
    b"\x93NUMPY": npy.read_npy,
    b"PK\x03\x04": npy.read_npz,
    b"PF": pfm.read,
    b"Pf": pfm.read,
    b"#?": radiance.read,
    b"II*\0": tiff.read,
    b"MM\0*": tiff.read,
    b"II+\0": tiff.read,
    b"MM\0+": tiff.read,
}
_OF_SCREENS = {
    b"\x89PNG": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"GIF8": "GIF",
    b"BM": "BMP",
    b"RIFF": "WebP",
    b"\xff\x0a": "JPEG XL",
    b"\0\0\0\x0cJXL ": "JPEG XL",
    b"P5": "PGM",
    b"P6": "PPM",
    b"qoif": "QOI",
}


def read(path: Path, layer: str | None = None) -> list[Image]:
    """The image of a file; several where it is a stack of replicates, (K, H, W, 3) in NPY or NPZ.

    Parameters
    ----------
    path : of the file.
    layer : name of the layer of OpenEXR, or of the array of NPZ, to read where there are several.

    Raises
    ------
    ValueError : one line that names the file, what is wrong, what is allowed or what to write instead.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file: allowed are images ({ALLOWED})")
    try:
        with path.open("rb") as file:
            first = file.read(12)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    for magic, reader in _READERS.items():
        if first.startswith(magic):
            return reader(path, layer)
    for magic, name in _OF_SCREENS.items():
        if first.startswith(magic):
            raise ValueError(
                f"{path}: is a {name} image, which holds what a screen shows, rounded, clipped and encoded, "
                "not radiance: write OpenEXR (float, ZIP), NPY or PFM"
            )
    if not first:
        raise ValueError(f"{path}: is empty, no image: it is cut short or was never written: allowed are {ALLOWED}")
    if any(magic.startswith(first[: len(magic)]) for magic in _READERS):
        raise ValueError(f"{path}: is cut short: it holds {len(first)} bytes: allowed are images ({ALLOWED})")
    raise ValueError(f"{path}: is no image of a kind that can be read: allowed are {ALLOWED}")


def read_one(path: Path, layer: str | None = None) -> Image:
    """The one image of a file; a ValueError for a stack of several."""
    images = read(path, layer)
    if len(images) > 1:
        raise ValueError(f"{path}: holds a stack of {len(images)} images: allowed is one")
    return images[0]


@attrs.frozen(eq=False)
class Replicates:
    """Replicates of one image, read from files.

    Attributes
    ----------
    pixels : (K, H, W, 3) float32, or float64 where the first file holds that; linear Rec. 709.
    names : what each is called in messages: its file, with an index where that is a stack.
    window : the display window of all.
    quantum : the coarsest rounding of any, see `Image.quantum`.
    notes : what was done to them, each once, behind the name of the first.
    colors : of all, see `Image.colors`.
    data : of the first, see `Image.data`.
    """

    pixels: np.ndarray
    names: list[str]
    window: Window
    quantum: float
    notes: list[str]
    colors: str
    data: Window | None

    def beside(self, other: "Replicates") -> list[str]:
        """What is to be said where these are compared with others.

        Raises
        ------
        ValueError : their pixels show other places (display windows), or one side has colours and the other none.
        """
        _same_window(self.names[0], self.window, other.names[0], other.window)
        for grey, colored in ((self, other), (other, self)):
            if grey.colors == GREY and colored.colors != GREY and not _is_grey(colored.pixels[0]):
                raise ValueError(
                    f"{grey.names[0]}: holds one channel, {colored.names[0]} has colours: allowed are equal ones: "
                    "write R, G and B"
                )
        if self.data == other.data:
            return []
        where = [
            f"{each.names[0]} holds {'all' if each.data is None else _places(each.data)}" for each in (self, other)
        ]
        return [f"data windows differ, and what lies outside is black: {where[0]}, {where[1]}"]


def replicates(paths: Sequence[Path], layer: str | None = None) -> Replicates:
    """Replicates from files and folders of them.

    Parameters
    ----------
    paths : files, or folders: all images in one by their names, those that begin with a dot left out.
    layer : as for `read`.

    Raises
    ------
    ValueError : as `read`; for a folder without images, or with images of several formats; for display windows that
        differ.
    """
    files = [each for given in paths for each in _files(given)]
    if not files:
        raise ValueError(f"no images given: allowed are {ALLOWED}, or folders of them")
    names, first, quantum, notes = [], None, 0.0, {}
    pixels = np.empty((0, 0, 0, 3), np.float32)
    for number, path in enumerate(files):
        found = read(path, layer)
        # All are read into one array, which a copy at the end would double; one file may hold several.
        room = len(names) + len(found) + len(files) - number - 1
        if not names:
            pixels = np.empty((room, *found[0].pixels.shape), found[0].pixels.dtype)
        elif room > len(pixels):
            pixels = np.concatenate([pixels, np.empty((room - len(pixels), *pixels.shape[1:]), pixels.dtype)])
        for k, image in enumerate(found):
            names.append(str(path) if len(found) == 1 else f"{path}[{k}]")
            first = first or image
            _same_window(names[-1], image.window, names[0], first.window)
            if image.colors != first.colors:
                raise ValueError(
                    f"{names[-1]}: its colours are {image.colors}, those of {names[0]} {first.colors}: allowed are "
                    "replicates of equal settings"
                )
            pixels[len(names) - 1] = image.pixels
            quantum = max(quantum, image.quantum)
            for note in image.notes:
                notes.setdefault(note, []).append(names[-1])
    said = [f"{where[0]}{f' and {len(where) - 1} more' if where[1:] else ''}: {note}" for note, where in notes.items()]
    assert first is not None
    return Replicates(pixels, names, first.window, quantum, said, first.colors, first.data)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    there = sorted(each for each in path.iterdir() if each.is_file() and not each.name.startswith("."))
    inside = [each for each in there if each.suffix.lower() in SUFFIXES]
    kinds = Counter(each.suffix.lower().replace(".tiff", ".tif") for each in inside)
    if not inside:
        others = sorted({each.suffix for each in there if each.suffix})
        found = f", only {', '.join(others)}" if others else ""
        raise ValueError(f"{path}: holds no image{found}: allowed are folders of {ALLOWED} (such as .exr)")
    if len(kinds) > 1:
        counted = " and ".join(f"{count} {kind}" for kind, count in kinds.items())
        raise ValueError(
            f"{path}: holds {counted} files, perhaps of the same images: allowed is one kind, or name them"
        )
    return inside


def _same_window(name: str, window: Window, other_name: str, other: Window) -> None:
    if window != other:
        raise ValueError(
            f"{name}: its picture (display window) is {_words(window)}, that of {other_name} {_words(other)}: "
            "allowed are equal ones"
        )


def _is_grey(pixels: np.ndarray) -> bool:
    return bool((pixels == pixels[..., :1]).all())


def _places(window: Window) -> str:
    left, top, right, bottom = window
    return f"x {left}-{right}, y {top}-{bottom}"


def _words(window: Window) -> str:
    left, top, right, bottom = window
    at = "" if (left, top) == (0, 0) else f" at ({left}, {top})"
    return f"{right - left + 1} x {bottom - top + 1}{at}"
