"""The arrays of an evaluation in its folder, as the figures read them."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from npred.lab.config import Evaluate
from npred.lab.config.results import Evaluated, PredictorId
from npred.lab.config.results.evaluate import Scores
from npred.lab.training.data import hdf5
from npred.plants import Plant

LOOP = {"t": 1, "X": 2, "U": 2, "D_hat": 1, "N": 1}  # axes of each array
ERRORS = {"sup": 1, "over_x": 2}
OF = {  # the rows of each kind, in words
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
        errors, loops = folder / "errors.h5", folder / "figure1.h5"
        (held_out,) = _arrays(errors, [""], {"X": 2, "D_hat": 1})
        prefixes = {kind: f"kinds/{kind}/" if number else "" for number, kind in enumerate(result.kinds)}
        kinds = {
            kind: _arrays(errors, [f"{prefix}networks/{network.name}/" for network in networks], {"sup": 1})
            for kind, prefix in prefixes.items()
        }
        densities = {f"loops/{each.name}": each for each in predictors if each.epoch is None}
        quantities = [*plant.states, *plant.inputs, "D_hat"]
        axes = dict.fromkeys(("edges", "data", *densities), 1)
        histograms = _arrays(folder / "coverage.h5", [f"{name}/" for name in quantities], axes)

        def series(group: str) -> dict[PredictorId, LoopSeries]:
            rows = _arrays(loops, [f"{group}{predictor.name}/" for predictor in predictors], LOOP)
            return {predictor: LoopSeries(**arrays) for predictor, arrays in zip(predictors, rows, strict=True)}

        by_network = _arrays(errors, [f"networks/{network.name}/" for network in networks], ERRORS)
        return cls(
            plant,
            config,
            result.models,
            result.gain,
            loops=series(""),
            **held_out,
            errors={network: ErrorArrays(**each) for network, each in zip(networks, by_network, strict=True)},
            coverage={
                name: Histogram(h["edges"], h["data"], {densities[key]: h[key] for key in densities})
                for name, h in zip(quantities, histograms, strict=True)
            },
            kinds={
                kind: {network: each["sup"] for network, each in zip(networks, arrays, strict=True)}
                for kind, arrays in kinds.items()
            },
            bounded=series("bounded/") if config.bounded else {},
        )


def _arrays(path: Path, groups: list[str], axes: dict[str, int]) -> list[dict[str, np.ndarray]]:
    """Of each group (the file itself is "") the arrays of these names, with so many axes."""
    with hdf5.opened(path, {group + name: count for group in groups for name, count in axes.items()}) as arrays:
        return [{name: arrays[group + name][:] for name in axes} for group in groups]
