"""What an evaluation left in its folder, as the figures read it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred.config import Evaluate
from npred.plants import Plant


@dataclass(frozen=True)
class Loop:
    """The loop of Fig. 1 with one predictor: t (nt,), X (nt, n), U (nt, m), D_hat (nt,), N (nt,) of the proof."""

    t: np.ndarray
    X: np.ndarray
    U: np.ndarray
    D_hat: np.ndarray
    N: np.ndarray


@dataclass(frozen=True)
class Errors:
    """|P_hat - P| of one network on held-out samples: sup over x (N,); over_x (nx, 3), median, 95 %, sup."""

    sup: np.ndarray
    over_x: np.ndarray


@dataclass(frozen=True)
class Histogram:
    """One quantity: edges (k + 1,), density of the data (k,) and of each contender's loops."""

    edges: np.ndarray
    data: np.ndarray
    loops: dict[str, np.ndarray]


@dataclass(frozen=True)
class Evidence:
    """An evaluation: its answer, and the arrays beside it; X (N, n) and D_hat (N,) of the held-out samples."""

    plant: Plant
    config: Evaluate
    models: dict[str, Any]
    gain: float | None
    loops: dict[str, Loop]
    X: np.ndarray
    D_hat: np.ndarray
    errors: dict[str, Errors]
    coverage: dict[str, Histogram]

    @classmethod
    def read(cls, folder: Path, plant: Plant, config: Evaluate, result: dict[str, Any]) -> "Evidence":
        """What lies in the folder of an evaluate artifact with that result."""
        order = list(result["models"])
        with h5py.File(folder / "errors.h5") as file:
            arrays: Any = file
            X, D_hat = arrays["X"][:], arrays["D_hat"][:]
            errors = {name: _arrays(Errors, arrays["networks"][name]) for name in order if name in arrays["networks"]}
        with h5py.File(folder / "figure1.h5") as file:
            loops = {name: _arrays(Loop, file[name]) for name in order}
        with h5py.File(folder / "coverage.h5") as file:
            names = [*plant.states, *plant.inputs, "D_hat"]
            coverage = {name: _histogram(file[name], order) for name in names}
        return cls(plant, config, result["models"], result["gain"], loops, X, D_hat, errors, coverage)


def _arrays(kind: type, group: Any) -> Any:
    return kind(**{name: group[name][:] for name in kind.__dataclass_fields__})


def _histogram(group: Any, order: list[str]) -> Histogram:
    loops = {name: group["loops"][name][:] for name in order if name in group["loops"]}
    return Histogram(group["edges"][:], group["data"][:], loops)
