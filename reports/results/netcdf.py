"""NetCDF for analysis: datasets with named dimensions, by groups."""

from pathlib import Path

import xarray

from termwise.scenes.store import write_atomically


def write_netcdf(path: Path, groups: dict[str, xarray.Dataset]) -> None:
    """Write datasets, by their paths in it, into one compressed file; it appears whole or not at all."""
    compressed = {"zlib": True, "complevel": 1, "shuffle": True}
    encoding = {name: dict.fromkeys(dataset.data_vars, compressed) for name, dataset in groups.items()}
    # By way of memory: HDF5 ends the whole process where a disk fills up under an open file.
    content = xarray.DataTree.from_dict(groups).to_netcdf(None, engine="h5netcdf", encoding=encoding)
    write_atomically(path, lambda temporary: temporary.write_bytes(content))
