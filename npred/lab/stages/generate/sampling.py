"""Rollouts as rows of data, in this process or in another one, on this machine or on another one.

Starts, delays, sample times and held-out rollouts are random draws, with one seed per rollout.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred import plants
from npred.base import array_checks, devices, grid, randomness
from npred.base.errors import ConfigError, DivergedError
from npred.base.registry import DELAY_LAWS, METHODS
from npred.kernels import compiler
from npred.lab.config import Generate, Pipeline, conditions
from npred.lab.config.conditions import Condition, box
from npred.lab.scheduler.configuration import identity
from npred.loop.closed_loop import Trajectories
from npred.loop.simulation import LANES
from npred.loop.trajectory_views import infeasible
from npred.plants import Plant, inputs
from npred.prediction.methods import numerical

Columns = dict[str, np.ndarray]
Progress = Callable[[int], None] | None
LAST = np.iinfo(np.int64).max  # a step that no loop comes to
PACKAGES = ("npred", "numpy")  # packages on which the bytes of a row may depend
NEAREST = 0.01  # the smallest displacement of a row over `spread`
SMOOTH = 6  # Legendre polynomials in a displacement of u


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
    plant = plants.resolve(*pipeline.of_plant)
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
    X0, D, D_hat, taken_at = starts(pipeline.seed, config, plant, chunk)
    predictor = numerical(config.predictor, plant, config.nx)
    noise = randomness.integer(pipeline.seed, "measurement")
    loops = Condition(config, X0, D, D_hat, config.t_end, noise, first=chunk.start).loops(
        plant, predictor, every=steps(config), samples=taken_at, progress=progress
    )
    if finite:
        _finite(plant, config, chunk, X0, loops)
    count, taken = taken_at.shape[1], loops.samples
    X, u, D_hat = redrawn(pipeline.seed, config, chunk, taken.X, taken.u, taken.D_hat)
    rows = {"X": X, "u": u, "D_hat": D_hat}
    rows |= {"D": D_hat if plant.declares_delay else np.repeat(D[:, None], count, 1), "t": taken_at * config.dt}
    finite_rows = array_checks.finite_rows(X, u, D_hat)  # a predictor refuses the others
    rows["P"] = np.full((*u.shape[:-1], plant.n), np.nan)
    rows["P"][finite_rows] = predictor(*(rows[name][finite_rows] for name in ("X", "u", "D_hat", "t")))
    rows["rollout"] = np.repeat(np.array(chunk, dtype=np.int32)[:, None], count, 1)
    kept = np.arange(count) < np.array([samples(config, r) for r in chunk])[:, None]
    return {name: array[kept] for name, array in rows.items()}


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


def starts(seed: int, config: Generate, plant: Plant, chunk: range) -> tuple[np.ndarray, ...]:
    """X0 (B, n), D and D_hat(0) (B,), sorted sample steps (B, S), each rollout's from its child seed."""
    low, high = box(plant, config, data=True).T
    regular, drawn = config.rollouts - config.explorers, []
    for r in chunk:
        rng = randomness.generator(seed, "rollout", r)
        D, D_hat = config.explore_D, config.explore_D_hat
        if r < regular:
            D = config.D if isinstance(config.D, tuple) else (config.D, config.D)
            D_hat = config.D_hat[r * len(config.D_hat) // regular]
        X0, D0, first = rng.uniform(low, high), rng.uniform(*D), rng.uniform(*D_hat)
        taken = np.sort(rng.choice(steps(config), samples(config, r), replace=False))
        drawn.append((X0, D0, first, np.pad(taken, (0, samples(config, 0) - len(taken)), mode="edge")))
    return tuple(np.array(column) for column in zip(*drawn, strict=True))


def redrawn(
    seed: int, config: Generate, chunk: range, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """X (B, S, n), u (B, S, nx, m), D_hat (B, S), the share `redraw` anew in the rollouts that are trained on."""
    X, u, D_hat, kept = X.copy(), u.copy(), D_hat.copy(), spared(seed, config)
    for k, r in enumerate(chunk):
        if config.redraw and r < config.rollouts and r not in kept:
            rng = randomness.generator(seed, "redraw", r)
            chosen = rng.random(len(D_hat[k])) < config.redraw
            D_hat[k, chosen] = rng.uniform(*config.explore_D_hat, chosen.sum())
            if config.spread:
                (aside, push), rows = spread(rng, config, X[k], u[k]), chosen[:, None]
                X[k] += rows * aside
                u[k] += rows[..., None] * push
    return X, u, D_hat


def spread(rng: np.random.Generator, config: Generate, X: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacements of X (S, n) and of u (S, nx, m), in units of the standard deviations of their columns.

    Each row has one size, from `spread` down to a hundredth of it, all orders of magnitude alike: the network is to be
    accurate near the loop, and not lost off it. That of u is a smooth function of x: its Legendre moments are normal,
    the k-th of standard deviation 1 / (1 + k).
    """
    size = config.spread * NEAREST ** rng.random((len(X), 1))
    shapes = np.polynomial.legendre.legvander(2 * grid.nodes(u.shape[1]) - 1, SMOOTH - 1)  # (nx, SMOOTH)
    moments = rng.standard_normal((len(u), SMOOTH, u.shape[2])) / (1 + np.arange(SMOOTH))[:, None]
    aside = size * X.std(axis=0) * rng.standard_normal(X.shape)
    return aside, size[..., None] * u.std(axis=(0, 1)) * (shapes @ moments)


def spared(seed: int, config: Generate) -> frozenset[int]:
    """The numbers of the data's held-out rollouts: at least one, never all, and no explorer."""
    regular = config.rollouts - config.explorers
    count = min(max(round(config.test_share * regular), 1), regular - 1)
    return frozenset(randomness.generator(seed, "held out").permutation(regular)[:count].tolist())


def explorers(config: Generate, most: int) -> range:
    """The numbers of explorers beyond those of the data, as large a share of them as is held out of the others.

    At most `most`, at least one; none where none is trained on.
    """
    count = min(max(round(config.test_share * config.explorers), 1), most) if config.explorers else 0
    return range(config.rollouts, config.rollouts + count)


def samples(config: Generate, rollout: int) -> int:
    """The samples of a rollout: an equal share, one more for the first ones where the division leaves a remainder."""
    share, remainder = divmod(config.samples, config.rollouts)
    return share + (rollout < remainder)


def steps(config: Generate) -> int:
    """The control steps of a rollout, the one at t = 0 included."""
    return round(config.t_end / config.dt) + 1
