"""Samples of the predictor operator as flat arrays in one HDF5 file."""

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np

from npred.base.errors import ConfigError
from npred.lab.training.data import hdf5
from npred.plants import Plant

MEANING = {
    "X": "plant state X(t), one row per sample (N, n), in the plant's units",
    "u": "actuator state u(x_j, t) = U(t + D (x_j - 1)) on nx uniform nodes of [0, 1], both ends in (N, nx, m)",
    "D_hat": "delay estimate (N,)",
    "P": "predictor P(x_j) = X + D_hat * integral of f(P, u) from 0 to x_j (N, nx, n)",
    "D": "true delay of the rollout (N,)",
    "t": "time of the sample in its rollout (N,)",
    "rollout": "number of the rollout (N,)",
    "test": "1 where the rollout is held out, else 0 (N,); no rollout has rows of both kinds",
}
AXES = {"X": 2, "u": 3, "D_hat": 1, "P": 3, "D": 1, "t": 1, "rollout": 1, "test": 1}


@dataclass(frozen=True)
class Dataset:
    """N samples: X (N, n), u (N, nx, m), D_hat, D, t (N,), P (N, nx, n), rollout (N,) int32, test (N,) uint8."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    P: np.ndarray
    D: np.ndarray
    t: np.ndarray
    rollout: np.ndarray
    test: np.ndarray

    def __len__(self) -> int:
        return len(self.X)

    def subset(self, test: bool) -> Self:
        """The rows of the held-out rollouts, or of the others."""
        rows = np.flatnonzero(self.test == int(test))
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def write(self, path: Path, attributes: dict[str, Any]) -> None:
        """One HDF5 file without time stamps: the same samples give the same bytes."""
        with h5py.File(path, "w", track_order=False) as file:
            file.attrs.update(attributes)
            for name, meaning in MEANING.items():
                file.create_dataset(name, data=getattr(self, name)).attrs["meaning"] = meaning

    @classmethod
    def read(cls, path: Path) -> Self:
        """The samples of a file. Raises StoreError for a file that is missing, broken or not as `write` writes it."""
        with hdf5.opened(path, AXES) as arrays:
            rows = {name: array.shape[0] for name, array in arrays.items()}
            if len(set(rows.values())) > 1:
                raise ValueError(f"arrays of different lengths {rows}")
            return cls(**{name: array[:] for name, array in arrays.items()})

    def fit(self, plant: Plant) -> None:
        """Raise ConfigError unless the arrays are of the plant's sizes, both parts of the split have rows, and every
        value is one that samples have, D and t being free to be unknown.
        """
        rows, nodes = self.u.shape[:2] if self.u.ndim == 3 else (0, 0)
        shapes = {"X": (rows, plant.n), "u": (rows, nodes, plant.m), "P": (rows, nodes, plant.n), "D_hat": (rows,)}
        for name, shape in shapes.items():
            got = getattr(self, name).shape
            if got != shape or nodes < 2:
                raise ConfigError(f"{name}: expected shape {shape} for plant {plant.name}, got {got}; check the file")
        finite = {name: ~np.isfinite(getattr(self, name)) for name in ("X", "u", "D_hat", "P")}
        wrong = {f"{name}: expected finite numbers": bad for name, bad in finite.items()}
        wrong |= {f"{name}: expected times from 0 on": getattr(self, name) < 0 for name in ("D_hat", "D")}
        wrong |= {"test: expected 1 where a row is held out, else 0": (self.test != 0) & (self.test != 1)}
        for expected, bad in wrong.items():
            bad_rows = bad.reshape(len(bad), -1).any(axis=1)
            if bad_rows.any():
                row = int(np.argmax(bad_rows))
                value = getattr(self, expected.partition(":")[0])[row][bad[row]].flat[0]
                raise ConfigError(f"{expected}, got {value:g} in row {row}; leave that row out")
        if not 0 < np.count_nonzero(self.test) < rows:
            got = f"{np.count_nonzero(self.test)} of {rows}"
            raise ConfigError(f"test: expected rows of both kinds, got {got} held out")


def attributes(plant: Plant, predictor: str) -> dict[str, Any]:
    """The attributes of a file of samples: the plant they are of, and the predictor that gave P."""
    return {
        "plant": plant.name,
        "states": list(plant.states),
        "inputs": list(plant.inputs),
        "parameters": json.dumps(plant.parameters),
        "predictor": predictor,
        "nodes": "x_j = j / (nx - 1), both ends in",
        "time unit": plant.time_unit,
    }
