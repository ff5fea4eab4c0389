"""The arrays of an evaluation in its folder, as the figures read them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from npred.lab.config import Evaluate
from npred.lab.config.results import Evaluated, PredictorId
from npred.lab.config.results.evaluate import Scores
from npred.lab.training.data import hdf5
from npred.plants import Plant

Key = TypeVar("Key")
LOOP = {"t": 1, "X": 2, "U": 2, "D_hat": 1, "N": 1}  # axes of each array
ERRORS = {"sup": 1, "over_x": 2}
OF = {  # rows by kind, in words
    "nominal": "nominal rollouts",
    "exploring": "exploring rollouts",
    "redrawn": "rows with a redrawn D̂",
    "imported": "the imported data",
}


@dataclass(frozen=True)
class LoopSeries:
    """The loop of Fig. 1 with one predictor: t (nt,), X (nt, n), U (nt, m), D_hat (nt,), N (nt,) of the proof."""

    t: np.ndarray
    X: np.ndarray
    U: np.ndarray
    D_hat: np.ndarray
    N: np.ndarray


@dataclass(frozen=True)
class ErrorArrays:
    """|P_hat - P| of one network on held-out samples: sup over x (N,); over_x (nx, 3), median, 95 %, sup."""

    sup: np.ndarray
    over_x: np.ndarray


@dataclass(frozen=True)
class Histogram:
    """One quantity: edges (k + 1,), density of the data (k,) and of each predictor's loops."""

    edges: np.ndarray
    data: np.ndarray
    loops: dict[PredictorId, np.ndarray]


@dataclass(frozen=True)
class EvaluationData:
    """An evaluation: its answer, and the arrays beside it; X (N, n) and D_hat (N,) of the held-out samples.

    X, D_hat and `errors` are of held-out samples of the first kind; `kinds` has the sup over x of |P_hat - P| by kind
    and network, (N,).
    """

    plant: Plant
    config: Evaluate
    models: dict[PredictorId, Scores]
    gain: float
    loops: dict[PredictorId, LoopSeries]
    X: np.ndarray
    D_hat: np.ndarray
    errors: dict[PredictorId, ErrorArrays]
    coverage: dict[str, Histogram]
    kinds: dict[str, dict[PredictorId, np.ndarray]]
    bounded: dict[PredictorId, LoopSeries] = field(default_factory=dict)  # loops with U within figure_bounds

    @property
    def samples(self) -> str:
        """The samples of X, D_hat and `errors`, in words."""
        return f"held-out samples of {OF[next(iter(self.kinds))]}"

    @classmethod
    def read(cls, folder: Path, plant: Plant, config: Evaluate, result: Evaluated) -> "EvaluationData":
        """The files in the folder of an evaluate artifact with that result."""
        predictors = list(result.models)
        networks = [predictor for predictor in predictors if predictor.is_network]
        final = {f"loops/{each.name}": each for each in predictors if each.epoch is None}
        errors, quantities = folder / "errors.h5", (*plant.states, *plant.inputs, "D_hat")

        def series(group: str) -> dict[PredictorId, LoopSeries]:
            arrays = _arrays(folder / "figure1.h5", {each: f"{group}{each.name}/" for each in predictors}, LOOP)
            return {predictor: LoopSeries(**each) for predictor, each in arrays.items()}

        def by_network(group: str, axes: dict[str, int]) -> dict[PredictorId, dict[str, np.ndarray]]:
            return _arrays(errors, {network: f"{group}networks/{network.name}/" for network in networks}, axes)

        kinds = {}
        for number, kind in enumerate(result.kinds):
            arrays = by_network(f"kinds/{kind}/" if number else "", {"sup": 1})
            kinds[kind] = {network: each["sup"] for network, each in arrays.items()}
        densities = dict.fromkeys(("edges", "data", *final), 1)
        histograms = _arrays(folder / "coverage.h5", {name: f"{name}/" for name in quantities}, densities)
        return cls(
            plant,
            config,
            result.models,
            result.gain,
            loops=series(""),
            **_arrays(errors, {"": ""}, {"X": 2, "D_hat": 1})[""],
            errors={network: ErrorArrays(**each) for network, each in by_network("", ERRORS).items()},
            coverage={
                name: Histogram(h["edges"], h["data"], {predictor: h[key] for key, predictor in final.items()})
                for name, h in histograms.items()
            },
            kinds=kinds,
            bounded=series("bounded/") if config.bounded else {},
        )


def _arrays(path: Path, groups: dict[Key, str], axes: dict[str, int]) -> dict[Key, dict[str, np.ndarray]]:
    """The arrays of these names, with so many axes, in each group; the group of the file itself is ""."""
    with hdf5.opened(path, {group + name: count for group in groups.values() for name, count in axes.items()}) as file:
        return {key: {name: file[group + name][:] for name in axes} for key, group in groups.items()}
