"""Errors of predictions: on held-out rows of each kind, on the numerical predictor's loops, and in the loop.

The data hold out nominal rollouts only. Those of the other kinds are made for the evaluation, in addition, from other
child seeds: the rows that are trained on stay as they are.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from npred.base import array_checks, randomness
from npred.lab.config import Evaluate, Generate, Pipeline
from npred.lab.config.conditions import Condition, Starts
from npred.lab.config.results import PredictorId
from npred.lab.config.results.evaluate import Errors, InLoop, KindErrors
from npred.lab.scheduler.job import Job
from npred.lab.stages.generate import sampling
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.plants import Plant
from npred.prediction.methods import Predictor, numerical

ROWS = 1024  # rows per call
FRESH = 40  # samples of each fresh loop, at random times …
START = 40.0  # … of its first delays: the start-up is in them, and not too much of the rest
LONGEST = 40.0  # delays in a loop that knows D: transients are over by then
SHORTEST = 4  # delays in it: two of them pass before the error is taken, and the last one has nothing to compare with
QUANTILES = (0.5, 0.95, 1.0)
NOMINAL, EXPLORING, REDRAWN, IMPORTED = "nominal", "exploring", "redrawn", "imported"
EXACT = Errors(mse=0.0, eps_sup=0.0, eps_kappa=0.0, rel_l2=0.0)  # the numerical predictor is the reference


class Labelled(NamedTuple):
    """Inputs and the reference's answer at times t: X (N, n), u (N, nx, m), D_hat (N,), P (N, nx, n), t (N,)."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray
    P: np.ndarray
    t: np.ndarray

    def finite(self) -> "Labelled":
        """The rows whose P is finite; P(0) = X."""
        kept = np.isfinite(self.P).all(axis=(1, 2))
        return Labelled(*(column[kept] for column in self))


def fresh(loops: Trajectories, t: np.ndarray, exact: Predictor) -> Labelled:
    """The samples taken at times t (B, S) from the numerical predictor's own loops of this evaluation."""
    taken = (loops.samples.X, loops.samples.u, loops.samples.D_hat, t)
    rows = [column.reshape(-1, *column.shape[2:]) for column in taken]
    finite = array_checks.finite_rows(*rows[:3])
    X, u, D_hat, t = (column[finite] for column in rows)
    return Labelled(X, u, D_hat, exact(X, u, D_hat, t), t).finite()


def held_out(job: Job, data: Dataset) -> dict[str, Labelled]:
    """Rows of each kind that the networks were trained on; the first are the data's, and the headline's.

    nominal: rollouts with the delays of `D` and `D_hat`, and the D_hat of the loop. exploring: rollouts with the
    delays of `explore_D` and `explore_D_hat`. redrawn: the rows of both with a D_hat drawn from `explore_D_hat`, and
    moved by `spread`. Of imported data, `imported`, nobody knows what they are. Rows that are not finite are left out,
    with a note.
    """
    config, test = job.config.generate, data.subset(test=True)
    nominal = Labelled(test.X, test.u, test.D_hat, test.P, test.t)
    if config.data:
        return {IMPORTED: nominal}
    kinds = {NOMINAL: nominal}
    if explored := sampling.explorers(config, _most(job.plant, config)):
        columns = sampling.rows(job.config, job.plant, explored, finite=False)
        kinds[EXPLORING] = _finite(job, EXPLORING, Labelled(*(columns[name] for name in Labelled._fields)))
    if config.redraw:
        X, u, _, _, t = (np.concatenate(column) for column in zip(*kinds.values(), strict=True))
        rng = randomness.generator(job.config.seed, "held out", "redraw")
        D_hat = rng.uniform(*config.explore_D_hat, len(X))
        aside, push = sampling.spread(rng, config, X, u) if config.spread else (0.0, 0.0)
        X, u = X + aside, u + push
        P = numerical(config.predictor, job.plant, config.nx)(X, u, D_hat, t)
        kinds[REDRAWN] = _finite(job, REDRAWN, Labelled(X, u, D_hat, P, t))
    return {name: rows for name, rows in kinds.items() if len(rows.X)}


def _most(plant: Plant, config: Generate) -> int:
    """Rollouts whose rows stand for all of their kind in memory."""
    return max(shards.SURVEY // (sampling.samples(config, 0) * shards.width(plant.n, plant.m, config.nx)), 1)


def _finite(job: Job, kind: str, rows: Labelled) -> Labelled:
    finite = rows.finite()
    if lost := len(rows.X) - len(finite.X):
        job.progress.note(f"evaluate: {lost} of {len(rows.X)} {kind} held-out rows have no finite P; left out")
    return finite


def sample_steps(seed: int, config: Evaluate, loops: int) -> np.ndarray:
    """At which steps the fresh rows are taken from each loop: (loops, FRESH), sorted."""
    rng = randomness.generator(seed, "evaluate", "fresh")
    count = round(min(START * config.D, config.case_t_end) / config.dt) + 1
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
            for network, predicted in P_hat.items():
                errors = gap(predicted[kind], rows)
                file[f"{group}networks/{network.name}/sup"] = errors.max(axis=1)
                file[f"{group}networks/{network.name}/over_x"] = np.quantile(errors, QUANTILES, axis=0).T


def in_loop(pipeline: Pipeline, begin: Starts) -> Condition:
    """Loops in which D_hat = D throughout, to compare predictions with the state one delay later.

    Errors on data compare a network with a numerical predictor on the same (X, u, D_hat). They cannot show the error of
    the numerical predictor, or of the u that the loop gives to it. This one can: its reference is the plant alone. D is
    the nearest whole number of control steps, so that X(t + D) is on a step, and not interpolated. The loops start in
    the state of Fig. 1, then in the initial states of the cases.
    """
    config = pipeline.evaluate
    D = max(round(config.D / config.dt), 1) * config.dt
    X0 = np.concatenate([begin.X0[:1], begin.X0[begin.cases][:: begin.repeats]])
    seed = randomness.integer(pipeline.seed, "evaluate", "in the loop")
    return Condition(config, X0, D, D, max(min(LONGEST * D, config.case_t_end), SHORTEST * D), seed, adapts=False)


def in_loop_error(plant: Plant, predictor: Predictor, at_D: Condition, progress: Callable[[int], None]) -> float:
    """The largest metrics.in_loop of these loops; infinite where one is lost."""
    loops = at_D.loops(plant, predictor, progress=progress)
    return float((metrics.in_loop_declared(loops) if plant.declares_delay else metrics.in_loop(loops, at_D.D)).max())


def about_in_loop(plant: Plant, at_D: Condition) -> InLoop:
    """The D = D_hat of these loops, the times that the error is the largest over, and their number.

    Of a plant that declares its delay there is no such D, and the times differ by loop.
    """
    if plant.declares_delay:
        return InLoop(D=None, start=None, to=at_D.t_end, loops=len(at_D.X0))
    D, start, to = (round(t, 9) for t in (at_D.D, 2 * at_D.D, at_D.t_end - at_D.D))  # 0.6, not 0.6…01
    return InLoop(D=D, start=start, to=to, loops=len(at_D.X0))
