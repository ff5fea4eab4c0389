"""Batches of rollouts as rows of data, in this process or in another one, on this machine or on another one."""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred import plants
from npred.base import array_checks, devices, randomness
from npred.base.errors import ConfigError, DivergedError
from npred.base.registry import DELAY_LAWS, METHODS
from npred.kernels import compiler
from npred.lab.config import Generate, Pipeline, conditions
from npred.lab.config.conditions import Condition
from npred.lab.scheduler.configuration import identity
from npred.lab.stages.generate import sampling
from npred.loop.closed_loop import Trajectories
from npred.loop.simulation import LANES
from npred.loop.trajectory_views import infeasible
from npred.plants import Plant, inputs
from npred.prediction.methods import Predictor, numerical

Columns = dict[str, np.ndarray]
Progress = Callable[[int], None] | None
LAST = np.iinfo(np.int64).max  # a step that no loop comes to
PACKAGES = ("npred", "numpy")  # what the bytes of a row may depend on


def surroundings(pipeline: Pipeline, plant: Plant) -> dict[str, Any]:
    """All that has to be the same in every process that makes rows of one data set."""
    versions = devices.packages(*PACKAGES) | {"compiler": compiler.version()}
    return {
        "plant": identity(plant),
        "delay law": DELAY_LAWS.identity(pipeline.generate.adaptation),
        "predictor": METHODS.identity(pipeline.generate.predictor),
        **versions,
    }


def elsewhere(pipeline: Pipeline, expected: dict[str, Any], batch: range) -> Columns:
    """The rows of a batch in another process. Raises ConfigError where plant or packages are not as expected."""
    plant = plants.resolve(pipeline.plant, pipeline.parameters, pipeline.kappa)
    actual = surroundings(pipeline, plant)
    other = ", ".join(name for name in expected if actual[name] != expected[name])
    if other:
        raise ConfigError(f"generate: expected the same {other} on every worker, got another; install it there")
    return rows(pipeline, plant, batch)


def compiled(pipeline: Pipeline, plant: Plant) -> bool:
    """True if the loops of rollouts are kernels throughout."""
    config = pipeline.generate
    return conditions.compiled(plant, numerical(config.predictor, plant, config.nx), config)


def rows(pipeline: Pipeline, plant: Plant, batch: range, finite: bool = True, progress: Progress = None) -> Columns:
    """The rows of the rollouts `batch`, which starts at a multiple of LANES.

    They are computed LANES at a time whatever the batch, so the bytes do not depend on how rollouts are batched.
    `progress` gets the number of loop steps done, now and then. Raises DivergedError, naming the rollout, where a state
    is not finite; without `finite` it stays in the rows.
    """
    chunks = [range(i, min(i + LANES, batch.stop)) for i in range(batch.start, batch.stop, LANES)]
    return joined([_chunk(pipeline, plant, chunk, finite, progress) for chunk in chunks])


def joined(parts: list[Columns]) -> Columns:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _chunk(pipeline: Pipeline, plant: Plant, chunk: range, finite: bool, progress: Progress) -> Columns:
    """Closed loops from random starts, sampled at random steps, P by the predictor."""
    config = pipeline.generate
    X0, D, D_hat0, steps = sampling.starts(pipeline.seed, config, plant, chunk)
    predictor = numerical(config.predictor, plant, config.nx)
    noise = randomness.integer(pipeline.seed, "measurement")
    loops = Condition(config, X0, D, D_hat0, config.t_end, noise, first=chunk.start).loops(
        plant, predictor, every=sampling.steps(config), samples=steps, progress=progress
    )
    if finite:
        _finite(plant, config, chunk, X0, loops)
    count = steps.shape[1]
    taken = loops.samples
    X, u, D_hat = sampling.redrawn(pipeline.seed, config, chunk, taken.X, taken.u, taken.D_hat)
    rows = {"X": X, "u": u, "D_hat": D_hat}
    rows |= {"D": D_hat if plant.declares_delay else np.repeat(D[:, None], count, 1), "t": steps * config.dt}
    rows["P"] = _predicted(predictor, rows)
    rows["rollout"] = np.repeat(np.array(chunk, dtype=np.int32)[:, None], count, 1)
    kept = np.arange(count) < np.array([sampling.samples(config, r) for r in chunk])[:, None]
    return {name: array[kept] for name, array in rows.items()}


def _predicted(predictor: Predictor, rows: Columns) -> np.ndarray:
    """P (B, S, nx, n) of the rows, NaN for those that are not finite, which a predictor refuses."""
    finite = array_checks.finite_rows(rows["X"], rows["u"], rows["D_hat"])
    P = np.full((*rows["u"].shape[:-1], predictor.plant.n), np.nan)
    P[finite] = predictor(*(rows[name][finite] for name in ("X", "u", "D_hat", "t")))
    return P


def _finite(plant: Plant, config: Generate, chunk: range, X0: np.ndarray, loops: Trajectories) -> None:
    if overtaking := infeasible(loops):
        rollout = chunk[int(np.argmin(np.where(loops.infeasible < 0, LAST, loops.infeasible)))]
        raise DivergedError(
            f"generate: commands would overtake each other in {(loops.infeasible >= 0).sum()} of {len(chunk)} "
            f"rollouts, in rollout {rollout} {' '.join(overtaking)}; shrink the box, or the plant's delay"
        )
    escaped = loops.escaped
    lost = np.flatnonzero(escaped >= 0)
    if len(lost):
        first = lost[np.argmin(escaped[lost])]
        u0 = inputs.sentence(plant, config.u0, inputs.bounds(plant, config.input_bounds))
        share = f"{len(lost)} of {len(chunk)} rollouts"
        raise DivergedError(
            f"generate: expected finite states, got NaN in rollout {chunk[first]} at "
            f"t = {plant.time_text(float(escaped[first]) * config.dt)}, from X0 = {X0[first].tolist()} ({share}); "
            f"shrink the box, D or dt, or set u0, the input before t = 0 (here {u0})"
        )
