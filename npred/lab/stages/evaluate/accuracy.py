"""Errors of a network on held-out rows of each kind, and on the numerical predictor's loops of the evaluation.

The data hold out nominal rollouts only. Those of the other kinds are made for the evaluation, in addition, from other
child seeds: the rows that are trained on stay as they are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import h5py
import numpy as np

from npred.base import array_checks, randomness
from npred.lab.config import Evaluate, Generate
from npred.lab.config.results import PredictorId
from npred.lab.config.results.evaluate import Errors, KindErrors
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.job import Job
from npred.lab.stages.generate import rollouts, sampling
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred.prediction.methods import Predictor, numerical

ROWS = 1024  # rows per call
FRESH = 40  # samples of each fresh loop, at random times …
START = 40.0  # … of its first seconds: the start-up is in them, and not too much of the rest
QUANTILES = (0.5, 0.95, 1.0)
NOMINAL, EXPLORING, REDRAWN, IMPORTED = "nominal", "exploring", "redrawn", "imported"
EXACT = Errors(mse=0.0, eps_sup=0.0, eps_kappa=0.0, rel_l2=0.0)  # the numerical predictor is the reference


@dataclass(frozen=True)
class Labelled:
    """Inputs and the reference's answer at times t: X (N, n), u (N, nx, m), D_hat (N,), P (N, nx, n), t (N,)."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    P: np.ndarray
    t: np.ndarray

    @classmethod
    def held_out(cls, data: Dataset) -> "Labelled":
        """The data's rows of rollouts that no network has seen."""
        test = data.subset(test=True)
        return cls(test.X, test.u, test.D_hat, test.P, test.t)

    @classmethod
    def fresh(cls, loops: Trajectories, t: np.ndarray, numerical: Predictor) -> "Labelled":
        """The samples taken at times t (B, S) from the numerical predictor's own loops of this evaluation."""
        taken = (loops.samples.X, loops.samples.u, loops.samples.D_hat, t)
        X, u, D_hat, t = (a.reshape(-1, *a.shape[2:]) for a in taken)
        finite = array_checks.finite_rows(X, u, D_hat)
        rows = cls(
            X[finite], u[finite], D_hat[finite], numerical(X[finite], u[finite], D_hat[finite], t[finite]), t[finite]
        )
        return rows.take(np.flatnonzero(np.all(np.isfinite(rows.P), axis=(1, 2))))

    @classmethod
    def joined(cls, parts: Sequence["Labelled"]) -> "Labelled":
        """Rows one after the other."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})

    def take(self, kept: np.ndarray) -> "Labelled":
        return Labelled(**{f.name: getattr(self, f.name)[kept] for f in fields(self)})


def held_out(job: Job, data: Dataset) -> dict[str, Labelled]:
    """Rows of each kind that the networks were trained on; the first are the data's, and the headline's.

    nominal: rollouts with the delays of `D` and `D_hat0`, and the D_hat of the loop. exploring: rollouts with the
    delays of `explore_D` and `explore_D_hat0`. redrawn: the rows of both with a D_hat drawn from `explore_D_hat0`, and
    moved by `spread`. Of imported data, `imported`, nobody knows what they are. Rows that are not finite are left out,
    with a note.
    """
    config, nominal = job.config.generate, Labelled.held_out(data)
    if config.data:
        return {IMPORTED: nominal}
    kinds, explored = {NOMINAL: nominal}, sampling.explorers(config, _most(job.plant, config))
    if explored:
        columns = rollouts.rows(job.config, job.plant, explored, finite=False)
        kinds[EXPLORING] = _finite(
            job.progress, EXPLORING, Labelled(**{name: columns[name] for name in ("X", "u", "D_hat", "P", "t")})
        )
    if config.redraw:
        kinds[REDRAWN] = _finite(job.progress, REDRAWN, _redrawn(job, Labelled.joined(list(kinds.values()))))
    return {name: rows for name, rows in kinds.items() if len(rows.X)}


def _most(plant: Plant, config: Generate) -> int:
    """Rollouts whose rows stand for all of their kind in memory."""
    return max(shards.SURVEY // (sampling.samples(config, 0) * shards.width(plant.n, plant.m, config.nx)), 1)


def _redrawn(job: Job, rows: Labelled) -> Labelled:
    config = job.config.generate
    rng = randomness.generator(job.config.seed, "held out", "redraw")
    D_hat = rng.uniform(*config.explore_D_hat0, len(rows.X))
    aside, push = sampling.spread(rng, config, rows.X, rows.u) if config.spread else (0.0, 0.0)
    X, u = rows.X + aside, rows.u + push
    return Labelled(X, u, D_hat, numerical(config.predictor, job.plant, config.nx)(X, u, D_hat, rows.t), rows.t)


def _finite(progress: Console, kind: str, rows: Labelled) -> Labelled:
    finite = np.flatnonzero(np.all(np.isfinite(rows.P), axis=(1, 2)))  # P(0) = X
    if lost := len(rows.X) - len(finite):
        progress.note(f"evaluate: {lost} of {len(rows.X)} {kind} held-out rows have no finite P; left out")
    return rows.take(finite)


def sample_steps(seed: int, config: Evaluate, loops: int) -> np.ndarray:
    """At which steps the fresh rows are taken from each loop: (loops, FRESH), sorted."""
    rng = randomness.generator(seed, "evaluate", "fresh")
    count = round(min(START, config.case_t_end) / config.dt) + 1
    return np.sort(rng.integers(0, count, (loops, FRESH)), axis=1)


def predict(predictor: Predictor, rows: Labelled) -> np.ndarray:
    """P_hat (N, nx, n) on those rows, a block at a time."""
    blocks = [slice(i, i + ROWS) for i in range(0, len(rows.X), ROWS)]
    return np.concatenate([predictor(rows.X[i], rows.u[i], rows.D_hat[i], rows.t[i]) for i in blocks])


def measure(plant: Plant, P_hat: np.ndarray, rows: Labelled) -> Errors:
    """All errors of npred.loop.metrics on those rows."""
    errors = metrics.errors(plant, P_hat, rows.P, rows.t, rows.D_hat)
    return Errors(**errors, **metrics.relative(plant, rows.X, rows.u, P_hat, rows.P))


def by_kind(plant: Plant, P_hat: Mapping[str, np.ndarray], kinds: Mapping[str, Labelled]) -> dict[str, KindErrors]:
    """The errors of one network on the rows of each kind, of which the first is the headline's.

    `above`: the share of the kind's rows whose largest error over x is above eps_sup of the first kind.
    """
    errors = {name: measure(plant, P_hat[name], rows) for name, rows in kinds.items()}
    first = next(iter(errors.values())).eps_sup
    above = {name: np.mean(gap(P_hat[name], rows).max(axis=1) > first) for name, rows in kinds.items()}
    return {name: KindErrors(**errors[name].set_values, above=above[name]) for name in kinds}


def gap(P_hat: np.ndarray, rows: Labelled) -> np.ndarray:
    """|P_hat - P| at each node, (N, nx)."""
    return np.linalg.norm(P_hat - rows.P, axis=-1)


def write(path: Path, kinds: Mapping[str, Labelled], P_hat: Mapping[PredictorId, Mapping[str, np.ndarray]]) -> None:
    """Write the errors of each network, as HDF5, with P_hat by network and kind.

    X and D_hat of the rows of the first kind, and by network |P_hat - P|: `sup` over x (N,), and `over_x` (nx, 3), the
    quantiles of QUANTILES over the rows at each node; the same below `kinds/KIND` for the rows of the others.
    """
    with h5py.File(path, "w") as file:
        file.attrs["quantiles"] = QUANTILES
        for number, (kind, rows) in enumerate(kinds.items()):
            group = f"kinds/{kind}/" if number else ""
            file[f"{group}X"], file[f"{group}D_hat"] = rows.X, rows.D_hat
            for contender, predicted in P_hat.items():
                errors = gap(predicted[kind], rows)
                file[f"{group}networks/{contender.name}/sup"] = errors.max(axis=1)
                file[f"{group}networks/{contender.name}/over_x"] = np.quantile(errors, QUANTILES, axis=0).T
