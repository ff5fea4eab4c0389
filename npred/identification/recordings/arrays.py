"""Arrays by name: .mat files of MATLAB, HDF5, .npz, and JSON as records, as arrays, or as a list of runs of either.

A field of a structure is called as s.field. The columns of a matrix are counted from 0: data[0], data[1], ...; those of
a JSON text that is a matrix from 1, as in a table without a header.
"""

import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from npred.base import json_files
from npred.base.errors import ConfigError, required
from npred.identification import recordings
from npred.identification.recordings import decoding
from npred.identification.recordings.table import NamedColumns, expanded, pd, time_name

Run = dict[str, Any]  # vectors by name
NUMBERED = re.compile(r"(demo|episode|traj|trajectory|run|trial|experiment)_?\d+", re.IGNORECASE)


class Arrays(NamedColumns):
    """The arrays in a file; `what` is its format for people."""

    what: str

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with decoding(path, self.what):
            runs = _runs(self.load())
        if not any(runs):
            raise ConfigError(f"{path}: expected vectors or structures in {self.what}, got none; save the recording so")
        columns = {name: pd.Series(array) for name, array in runs[0].items()}
        if len(runs) > 1:
            frames = [pd.DataFrame(_longest(run)) for run in runs]
            columns = dict(pd.concat(frames, ignore_index=True).items())
            self.place = np.concatenate([np.arange(len(frame)) for frame in frames])
            self.notes.append(f"the file holds {len(runs)} runs; their rows are counted through.")
        self.counted(columns)

    def load(self) -> Any:
        """The value in the file."""
        raise NotImplementedError


class Mat(Arrays):
    """A .mat file of any version."""

    what = "a .mat file"

    def load(self) -> Any:
        io = required("recording mat", "scipy.io", "scipy", "identify")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a name that a file has twice
                value = io.loadmat(self.path, simplify_cells=True)
        except NotImplementedError:  # version 7.3 is HDF5
            return hdf5(self.path, lambda data: np.asarray(data).T)  # MATLAB reverses dimensions
        return {name: item for name, item in value.items() if not name.startswith(("__", "#"))}


class Hdf5(Arrays):
    """An HDF5 file: groups are structures, a table has its columns. Groups as demo_0, demo_1 are runs."""

    what = "an HDF5 file"

    def load(self) -> Any:
        return hdf5(self.path, np.asarray)


class Npz(Arrays):
    """Arrays that NumPy saved."""

    what = "an .npz file"

    def load(self) -> Any:
        with np.load(json_files.regular(self.path), allow_pickle=False) as file:
            return dict(file)


class Json(Arrays):
    """A JSON text, or one in each line."""

    what = "a JSON text"

    def load(self) -> Any:
        text = recordings.text_of(self.path, self.what)
        try:
            return json_files.parse(text)
        except ValueError:
            lines = [line for line in text.splitlines() if line.strip()]
            if len(lines) < 2 or not lines[0].rstrip().endswith(("}", "]")):
                raise
            return [json_files.parse(line) for line in lines]


def hdf5(path: Path, taken: Callable[[Any], np.ndarray]) -> Any:
    """The arrays in the groups of an HDF5 file, by name; `taken` makes one of a data set."""
    import h5py

    def of(group: Any) -> Any:
        if hasattr(group, "items"):
            return {name.lstrip("#"): of(item) for name, item in group.items() if name != "#refs#"}
        if names := group.dtype.names:
            return {name: group[name] for name in names}
        return taken(group) if group.dtype.kind in "fiub" and "MATLAB_empty" not in group.attrs else None

    with h5py.File(path) as file:
        return of(file)


def _runs(value: Any) -> list[Run]:
    """The runs in a value, each with its columns: of all its parts the one with the most rows."""
    if isinstance(value, Mapping):
        if value and all(NUMBERED.fullmatch(name) for name in value):
            return _runs(list(value.values()))
        runs = [[dict(_vectors(value))], *map(_runs, value.values())]
        return max(runs, key=lambda each: sum(len(next(iter(_longest(run).values()), [])) for run in each))
    if not isinstance(value, list | np.ndarray) or not len(value):
        return []
    if all(isinstance(item, Mapping) for item in value):
        scalars = any(time_name(key)[0] is not None and np.ndim(item) == 0 for key, item in value[0].items())
        runs = [] if scalars else [run for item in value if (run := dict(_vectors(item)))]
        return runs or [expanded(pd.json_normalize(list(value)))]
    matrix = _array(value)
    return [{str(k): column for k, column in enumerate(matrix.T, 1)}] if matrix is not None and matrix.ndim == 2 else []


def _longest(run: Run) -> Run:
    """Those vectors of a run that are as long as its longest one."""
    rows = max(map(len, run.values()), default=0)
    return {name: array for name, array in run.items() if len(array) == rows}


def _vectors(value: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Vectors, and the columns of matrices, by name."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _vectors(item, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | np.ndarray) and (array := _array(value)) is not None and array.size > 1:
        array = np.squeeze(array) if array.ndim > 1 else array
        if array.ndim == 1:
            yield name, array
        elif array.ndim == 2:
            for k, column in enumerate(array.T if array.shape[0] >= array.shape[1] else array):
                yield f"{name}[{k}]", column


def _array(value: Any) -> np.ndarray | None:
    """Numbers or texts as an array; None for lists of other things."""
    try:
        array = np.asarray(value, dtype=None if isinstance(value, np.ndarray) else float)
    except (TypeError, ValueError):
        texts = isinstance(value, list) and all(isinstance(item, str | None) for item in value)
        return np.array(value, dtype=object) if texts else None
    return array if array.dtype.kind in "fiubU" else None
