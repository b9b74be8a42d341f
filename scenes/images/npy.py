"""NumPy's files: an image, or a stack of replicates (K, H, W, 3); NPZ has layers, its arrays."""

from pathlib import Path

import numpy as np

from termwise.scenes.images.image import Image, cut_short


def read_npy(path: Path, layer: str | None) -> list[Image]:
    """The images of an NPY file, mapped and not copied; a ValueError says what is wrong."""
    if layer is not None:
        raise ValueError(f"{path}: layer = {layer!r}: an NPY file has none: allowed is to name none")
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # ValueError, EOFError, SyntaxError: whatever its header holds
        raise _unreadable(path, error) from None
    assert isinstance(array, np.memmap)
    if path.stat().st_size != array.offset + array.nbytes:
        raise ValueError(f"{path}: holds more than one array: allowed is one")
    return _images(path, array)


def read_npz(path: Path, layer: str | None) -> list[Image]:
    """The images of one array of an NPZ file; a ValueError says what is wrong, or which arrays there are."""
    try:
        with np.load(path, allow_pickle=False) as file:
            names = list(file.files)
            if layer is None and len(names) == 1:
                layer = names[0]
            array = file[layer] if layer in names else None
    except Exception as error:  # ValueError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, ...
        raise _unreadable(path, error) from None
    if array is None:
        raise ValueError(f"{path}: layer = {layer!r}: allowed is one of its arrays: {', '.join(map(repr, names))}")
    return _images(path, array)


def _images(path: Path, array: np.ndarray) -> list[Image]:
    if array.ndim == 4:
        if len(array) == 0:
            raise ValueError(f"{path}: shape {array.shape}: allowed is (replicates, height, width, 3), none of them 0")
        return [Image.of_array(path, image) for image in array]
    return [Image.of_array(path, array)]


def _unreadable(path: Path, error: Exception) -> ValueError:
    said = " ".join(str(error).split()) or type(error).__name__
    if any(word in said for word in ("mmap length", "EOF", "not a zip file")):  # NumPy's and zipfile's words for it
        return cut_short(path, said)
    return ValueError(f"{path}: is damaged, or holds no numbers ({said}): write it again")
