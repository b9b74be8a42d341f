"""Images for viewers: OpenEXR with named parts, float32, linear Rec. 709, the provenance in its header."""

import errno
from pathlib import Path

import numpy as np
import OpenEXR

from termwise.scenes.store import write_atomically


def write_exr(path: Path, parts: dict[str, np.ndarray], header: dict[str, str]) -> None:
    """Write (H, W, 3) images as the named parts of one OpenEXR file; it appears whole or not at all."""
    described = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    file = OpenEXR.File(
        [
            OpenEXR.Part(dict(described), {"RGB": np.ascontiguousarray(image, np.float32)}, name)
            for name, image in parts.items()
        ]
    )

    def write(temporary: Path) -> None:
        try:
            file.write(str(temporary))
        except RuntimeError:  # OpenEXR's word for a full disk, with the temporary name in it
            raise OSError(errno.EIO, "could not be written: is the disk full?", str(path)) from None

    write_atomically(path, write)


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """The RGB images of an OpenEXR file by part name, (H, W, 3) float32; a ValueError says what is wrong.

    A file of one part without a name gives the key "".
    """
    try:
        with OpenEXR.File(str(path)) as file:
            found = {}
            for part in file.parts:
                channels = part.channels
                name = part.name() if callable(part.name) else part.name
                if "RGB" in channels or "RGBA" in channels:
                    pixels = channels["RGB" if "RGB" in channels else "RGBA"].pixels
                    found[name or ""] = np.asarray(pixels[..., :3], np.float32)
    except Exception as error:  # OpenEXR raises RuntimeError, TypeError and KeyError alike
        why = " ".join(str(error).split())
        raise ValueError(f"{path}: is not an OpenEXR image ({why}): allowed are whole ones") from None
    if not found:
        raise ValueError(f"{path}: holds no RGB channels: allowed are OpenEXR images with R, G and B")
    return found
