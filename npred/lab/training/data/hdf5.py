"""HDF5 files from anywhere: every array is checked before a byte of it is read or memory is taken for it.

The format can point to other files, load plug-ins, and announce arrays of any size. Here an array is plain numbers in
the file itself, no larger than what is stored, or a virtual one joined from shards that lie beside it.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from npred.base.errors import StoreError, first_line

FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}  # built in, no plug-in
SWELL = 1040  # times its stored size: what deflate can at most unpack to
SHARD = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]*\.h5")
_BROKEN = (OSError, KeyError, ValueError, RuntimeError, TypeError, OverflowError, AttributeError, NotImplementedError)


@contextmanager
def opened(path: Path, arrays: Mapping[str, int]) -> Iterator[Mapping[str, Any]]:
    """The arrays (name: number of axes) of a file as h5py datasets, checked; they are read while it is open.

    Raises StoreError, naming the file and what is wrong with it, also where reading fails.
    """
    try:
        with _file(path) as file:
            datasets = {name: _dataset(file, name) for name in arrays}
            for name, axes in arrays.items():
                _check(datasets[name], name, axes, path)
            yield datasets
    except _BROKEN as error:
        expected = f"{path}: expected the arrays {', '.join(arrays)}"
        raise StoreError(f"{expected}, got: {first_line(error)}; generate it again") from None


def _file(path: Path) -> h5py.File:
    if not path.is_file():
        raise ValueError("no regular file")
    return h5py.File(path, "r", locking=False)  # results never change, and a store may be read-only or on NFS


def _dataset(file: h5py.File, name: str) -> h5py.Dataset:
    levels = name.split("/")
    for last in range(1, len(levels) + 1):  # a link anywhere on the way leads elsewhere as well
        if not isinstance(file.get("/".join(levels[:last]), getlink=True), h5py.HardLink):
            raise ValueError(f"{name} is missing, or a link to elsewhere")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiu":
        raise ValueError(f"{name} is no array of numbers")
    return dataset


def _check(array: h5py.Dataset, name: str, axes: int, path: Path) -> None:
    if array.ndim != axes:
        raise ValueError(f"{name} has shape {array.shape}, not {axes} axes")
    room = _joined(array, name, path) if array.is_virtual else _stored(array, name, path)
    if array.size * array.dtype.itemsize > room:
        raise ValueError(f"{name} of shape {array.shape} is larger than what is stored of it")


def _stored(array: h5py.Dataset, name: str, path: Path) -> int:
    """The bytes that the array may have."""
    layout = array.id.get_create_plist()
    filters = {layout.get_filter(k)[0] for k in range(layout.get_nfilters())}
    if array.external or not filters <= FILTERS:
        raise ValueError(f"{name} is kept in another file or packed by filter {sorted(filters - FILTERS)}")
    size = min(array.id.get_storage_size(), path.stat().st_size)
    return size * SWELL if filters else size


def _joined(array: h5py.Dataset, name: str, path: Path) -> int:
    """The bytes of the shards behind a virtual array, each of them checked."""
    room, checked = 0, set()
    for source in array.virtual_sources():
        if not SHARD.fullmatch(source.file_name) or source.file_name == path.name:
            raise ValueError(f"{name} is joined from {source.file_name!r}, no file beside it")
        if source.dset_name.strip("/") != name:  # others, with %b or links on the way, are not checked
            raise ValueError(f"{name} is joined from {source.dset_name!r} of {source.file_name}")
        if source.file_name not in checked:
            checked.add(source.file_name)
            room += _shard(path.with_name(source.file_name), name, array.ndim)
    return room


def _shard(path: Path, name: str, axes: int) -> int:
    if path.is_symlink():
        raise ValueError(f"{path.name} is a link")
    with _file(path) as file:
        array = _dataset(file, name)
        if array.is_virtual:
            raise ValueError(f"{path.name} is itself joined from others")
        _check(array, name, axes, path)
        return array.size * array.dtype.itemsize
