"""Images for viewers: OpenEXR with named parts, float32, linear Rec. 709, the provenance in its header."""

import errno
from pathlib import Path

import numpy as np
import OpenEXR

from termwise.scenes.images import openexr
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
            with openexr.every_core():
                file.write(str(temporary))
        except RuntimeError:  # OpenEXR's word for a full disk, with the temporary name in it
            raise OSError(errno.EIO, "could not be written: is the disk full?", str(path)) from None

    write_atomically(path, write)


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """The layers of an OpenEXR file by name, (H, W, 3) float32; a ValueError says what is wrong."""
    return {name: image.pixels for name, image in openexr.read_all(path).items()}
