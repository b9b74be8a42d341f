"""NetCDF for analysis: variables with named dimensions, and datasets of them by groups."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5netcdf
import h5py
import numpy as np

from termwise.scenes.store import write_atomically

if TYPE_CHECKING:
    import xarray

_COMPRESSED = 2**22
"""Numbers of the largest array that is compressed: of larger ones, noise that shrinks by a third takes seconds."""


def _storage(values: Any) -> dict[str, Any]:
    """How an array is stored, in HDF5's words, which xarray's writer takes too."""
    return {"compression": "gzip", "compression_opts": 1, "shuffle": True} if values.size <= _COMPRESSED else {}


def write_netcdf(path: Path, groups: "dict[str, xarray.Dataset]") -> None:
    """Write datasets, by their paths in it, into one file, compressed; it appears whole or not at all."""
    import xarray  # here: a comparison of images, which is one flat dataset, does not wait a second for it

    encoding = {
        name: {each: _storage(values) for each, values in dataset.data_vars.items()} for name, dataset in groups.items()
    }
    # By way of memory: HDF5 ends the whole process where a disk fills up under an open file.
    content = xarray.DataTree.from_dict(groups).to_netcdf(None, engine="h5netcdf", encoding=encoding)
    write_atomically(path, lambda temporary: temporary.write_bytes(content))


def write_variables(
    path: Path, variables: Mapping[str, tuple[tuple[str, ...], np.ndarray]], attributes: Mapping[str, Any]
) -> None:
    """Write variables, each with the names of its dimensions, as one dataset; else as `write_netcdf`.

    Text is an array of objects.
    """
    content = io.BytesIO()  # as above
    with h5netcdf.File(content, "w") as file:
        file.attrs.update(attributes)
        file.dimensions.update(
            {name: size for names, values in variables.values() for name, size in zip(names, values.shape, strict=True)}
        )
        for name, (dimensions, values) in variables.items():
            if values.dtype == object:
                file.create_variable(name, dimensions, h5py.string_dtype(), values)
                continue
            fill = values.dtype.type(np.nan)
            file.create_variable(name, dimensions, data=values, fillvalue=fill, **_storage(values))
    write_atomically(path, lambda temporary: temporary.write_bytes(content.getbuffer()))
