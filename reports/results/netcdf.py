"""NetCDF for analysis: datasets with named dimensions, by groups."""

from pathlib import Path

import xarray

from termwise.scenes.store import write_atomically

_COMPRESSED = 2**22
"""Numbers of the largest array that is compressed: of larger ones, noise that shrinks by a third takes seconds."""


def write_netcdf(path: Path, groups: dict[str, xarray.Dataset]) -> None:
    """Write datasets, by their paths in it, into one file, compressed; it appears whole or not at all."""
    compressed = {"zlib": True, "complevel": 1, "shuffle": True}
    encoding = {
        name: {each: compressed for each, values in dataset.data_vars.items() if values.size <= _COMPRESSED}
        for name, dataset in groups.items()
    }
    # By way of memory: HDF5 ends the whole process where a disk fills up under an open file.
    content = xarray.DataTree.from_dict(groups).to_netcdf(None, engine="h5netcdf", encoding=encoding)
    write_atomically(path, lambda temporary: temporary.write_bytes(content))
