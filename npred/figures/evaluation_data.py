"""The arrays of an evaluation in its folder, as the figures read them."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from npred.config import Evaluate
from npred.data import hdf5
from npred.plants import Plant
from npred.results import Evaluated, PredictorId
from npred.results.evaluate import Scores

LOOP = {"t": 1, "X": 2, "U": 2, "D_hat": 1, "N": 1}  # axes of each array
ERRORS = {"sup": 1, "over_x": 2}
OF = {  # what rows of each kind are of
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
    """One quantity: edges (k + 1,), density of the data (k,) and of each contender's loops."""

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
        order = list(result.models)
        networks = [contender for contender in order if contender.is_network]
        densities = {f"loops/{contender.name}": contender for contender in order if contender.epoch is None}
        (rows,) = _arrays(folder / "errors.h5", [""], {"X": 2, "D_hat": 1})
        errors = _arrays(folder / "errors.h5", [f"networks/{c.name}/" for c in networks], ERRORS)
        loops = _loops(folder / "figure1.h5", order)
        quantities = [*plant.states, *plant.inputs, "D_hat"]
        kinds = dict.fromkeys(("edges", "data", *densities), 1)
        histograms = _arrays(folder / "coverage.h5", [f"{name}/" for name in quantities], kinds)
        coverage = [Histogram(h["edges"], h["data"], {densities[k]: h[k] for k in densities}) for h in histograms]
        return cls(
            plant, config, result.models, result.gain,
            loops, **rows,
            errors={c: ErrorArrays(**arrays) for c, arrays in zip(networks, errors, strict=True)},
            coverage=dict(zip(quantities, coverage, strict=True)), kinds=_by_kind(folder, result.kinds, networks),
            bounded=_loops(folder / "figure1.h5", order, "bounded/") if config.bounded else {},
        )  # fmt: skip


def _loops(path: Path, order: list[PredictorId], group: str = "") -> dict[PredictorId, LoopSeries]:
    series = _arrays(path, [f"{group}{c.name}/" for c in order], LOOP)
    return {c: LoopSeries(**arrays) for c, arrays in zip(order, series, strict=True)}


def _by_kind(
    folder: Path, kinds: Iterable[str], networks: list[PredictorId]
) -> dict[str, dict[PredictorId, np.ndarray]]:
    """The sup over x of each network's error by kind of row; those of the first kind are the file's."""
    prefixes = {kind: f"kinds/{kind}/" if number else "" for number, kind in enumerate(kinds)}
    groups = {kind: [f"{prefix}networks/{c.name}/" for c in networks] for kind, prefix in prefixes.items()}
    by_kind = {kind: _arrays(folder / "errors.h5", group, {"sup": 1}) for kind, group in groups.items()}
    return {
        kind: {name: a["sup"] for name, a in zip(networks, arrays, strict=True)} for kind, arrays in by_kind.items()
    }


def _arrays(path: Path, groups: list[str], axes: dict[str, int]) -> list[dict[str, np.ndarray]]:
    """Of each group (the file itself is "") the arrays of these names, with so many axes."""
    with hdf5.opened(path, {group + name: count for group in groups for name, count in axes.items()}) as arrays:
        return [{name: arrays[group + name][:] for name in axes} for group in groups]
