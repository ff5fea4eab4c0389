"""Data larger than memory: shards that lie beside data.h5, each written by one process, and data.h5 joins them.

For MATLAB and h5py data.h5 is one file like any other. Here the shards are read one at a time.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred.lab.training.data import hdf5
from npred.lab.training.data.dataset import AXES, MEANING, Dataset

WHOLE = 2**29  # bytes of rows up to which data are one file: a constant, for a key must not depend on a machine
SHARD = 2**27  # bytes of a shard
SURVEY = 2**28  # bytes of rows that stand for all of them


def name(number: int) -> str:
    return f"data-{number:05d}.h5"


def width(n: int, m: int, nx: int) -> int:
    """Bytes of a row: X, u, D_hat, P, D and t in float64, rollout in int32, test."""
    return 8 * (n + nx * m + 1 + nx * n + 1 + 1) + 4 + 1


def join(folder: Path, rows: Sequence[int], attributes: dict[str, Any]) -> None:
    """Write data.h5: the shards of a folder, of so many rows each, one after the other. A lost shard reads as NaN."""
    with h5py.File(folder / name(0), "r") as first:
        kinds = {key: (first[key].shape[1:], first[key].dtype) for key in MEANING}  # type: ignore[union-attr]
    with h5py.File(folder / "data.h5", "w", track_order=False) as file:
        file.attrs.update(attributes)
        for key, meaning in MEANING.items():
            shape, kind = kinds[key]
            lost = math.nan if kind.kind == "f" else int(np.iinfo(kind).max)
            layout, stop = h5py.VirtualLayout((sum(rows), *shape), kind), 0
            layout.dcpl.set_obj_track_times(False)  # the same shards give the same bytes
            for number, count in enumerate(rows):
                layout[stop : stop + count] = h5py.VirtualSource(name(number), key, shape=(count, *shape))
                stop += count
            joined = file.create_virtual_dataset(key, layout, lost)
            joined.attrs["meaning"] = meaning


def files(path: Path) -> list[Path]:
    """The files with the rows of a data.h5: its shards in their order, or itself."""
    with hdf5.opened(path, {"X": AXES["X"]}) as arrays:
        joined = arrays["X"].virtual_sources() if arrays["X"].is_virtual else []
        return [path.with_name(shard.file_name) for shard in joined] or [path]


def parts(path: Path) -> Iterator[Dataset]:
    """The rows of a data.h5, a shard at a time; of a single file all at once."""
    return map(Dataset.read, files(path))


def column(path: Path, key: str) -> Iterator[np.ndarray]:
    """One array of a data.h5, a shard at a time."""
    for part in files(path):
        with hdf5.opened(part, {key: AXES[key]}) as arrays:
            yield arrays[key][:]


def survey(path: Path) -> Dataset:
    """The rows of a single file; of shards every k-th row, with the smallest k that leaves SURVEY bytes of them."""
    shards = files(path)
    if len(shards) == 1:
        return Dataset.read(shards[0])
    with hdf5.opened(path, AXES) as arrays:
        step = math.ceil(sum(array.size * array.dtype.itemsize for array in arrays.values()) / SURVEY)
    taken, first = [], 0
    for part in map(Dataset.read, shards):
        taken.append({key: getattr(part, key)[-first % step :: step].copy() for key in MEANING})
        first += len(part)
    return Dataset(**{key: np.concatenate([rows[key] for rows in taken]) for key in MEANING})
