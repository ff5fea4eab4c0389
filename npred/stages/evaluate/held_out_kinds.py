"""Held-out rows by kind: those of nominal rollouts, of exploring ones, and rows with a redrawn D_hat.

The data hold out nominal rollouts alone. Those of the other kinds are made for the evaluation, in addition, from child
other seeds: the rows that are trained on stay as they are.
"""

import numpy as np

from npred import randomness
from npred.config import Generate
from npred.data import shards
from npred.data.dataset import Dataset
from npred.plants import Plant
from npred.predictors import numerical
from npred.stages.evaluate.accuracy import Labelled
from npred.stages.generate import rollouts, sampling
from npred.stages.job import Job
from npred.terminal.console import Console

NOMINAL, EXPLORING, REDRAWN, IMPORTED = "nominal", "exploring", "redrawn", "imported"


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
