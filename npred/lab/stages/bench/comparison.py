"""Predictors of one plant side by side: the time of a call, the error along a loop, and the loop with each."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import ceil
from typing import Any

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.base.notebook import InNotebook
from npred.lab.report.figures.table import Column, Table
from npred.lab.stages.bench import bench, timing
from npred.lab.stages.bench.candidates import PROBES, Reference
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories, simulate
from npred.loop.trajectory_views import pandas
from npred.plants import Plant
from npred.plants.base import require
from npred.prediction.methods import RK4, Predictor

CALLS, SECONDS = 2000, 0.5  # timed calls of a predictor: so many, or as many as take so long


@dataclass(frozen=True)
class Compared:
    """A predictor of a comparison.

    `us` is the median time of a call of one loop, in microseconds, and `p999_us` what 99.9 % of them take at most, the
    check of a guard included. `eps_sup` and `eps_median` are the largest and the median over samples of
    sup_x |P̂ - P|. Of the loops: the largest `radius`, the share `converged`, the median `settle_time`.
    """

    predictor: str
    us: float
    p999_us: float
    eps_sup: float
    eps_median: float
    radius: float
    converged: float
    settle_time: float


@dataclass(frozen=True, repr=False)
class Comparison(InNotebook):
    """A row for each predictor, and its `loops` by name, Trajectories each; `print` shows the table."""

    rows: tuple[Compared, ...]
    loops: Mapping[str, Trajectories]
    time_unit: str = "s"

    def __repr__(self) -> str:
        columns = [
            Column("predictor", [row.predictor for row in self.rows]),
            Column("µs", [row.us for row in self.rows], ".1f"),
            Column("ε sup", [row.eps_sup for row in self.rows], digits=2),
            Column("ε median", [row.eps_median for row in self.rows], digits=2),
            Column("radius", [row.radius for row in self.rows], digits=2),
            Column("converged", [row.converged for row in self.rows], ".0%"),
            Column(f"settles ({self.time_unit})", [row.settle_time for row in self.rows], digits=3),
        ]
        return Table("compared", "Predictors side by side", columns).terminal()

    def to_dataframe(self) -> Any:
        """A pandas DataFrame: a row for each predictor, the fields of Compared as columns. Raises MissingError."""
        return pandas().DataFrame([asdict(row) for row in self.rows]).set_index("predictor")


def compare(
    plant: Plant, predictors: Mapping[str, Predictor] | Sequence[Predictor], *, X0: Any, t_end: float, D: Any = None,
    D_hat: Any = None, dt: float | None = None, **loop: Any,
) -> Comparison:  # fmt: skip
    """The predictors of a plant, each timed, with its error, and with its results in the same loops.

    Errors are taken along these loops with RK4, on at most 200 samples after the first delay, against RK4 on 2000
    steps. Calls are of one loop, as a compiled loop makes them, all predictors in turn. A loop has converged that ends
    within 1 % of the target. It takes about a second for each predictor.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    predictors : list or dict of Predictor
        A dict gives the names that the table shows.
    X0 : array (..., n), in the plant's units
        States at t = 0.
    t_end : float, in the plant's unit of time
        Length of the loops.
    D : array (...) or function of t, in the plant's unit of time, optional
        True delay, where inputs have several the longest. A function is a delay that drifts or jumps. None for a
        plant that declares its delay.
    D_hat : array (...), in the plant's unit of time, optional
        Estimate of the delay; None for a plant that declares it.
    dt : float, in the plant's unit of time, optional
        Control step; U is held over it. By default that of npred.simulate.
    **loop : see simulate
        All other parameters of the loops.

    Returns
    -------
    Comparison
        A row for each predictor, and its `loops` by name, Trajectories each; `print` shows the table.

    Raises
    ------
    ConfigError
        As npred.simulate does, and where no sample is left.
    """
    require(plant)
    named = _named(predictors)
    delays = {} if plant.declares_delay else {"D": D, "D_hat": D_hat}
    about = {"X0": X0, "t_end": t_end, "dt": dt, **delays, **loop}
    loops = {name: simulate(plant, run, **about) for name, run in named.items()}
    reference = _reference(plant, about, next(iter(loops.values())))
    times = timing.sample({name: bench.call(reference, run) for name, run in named.items()}, CALLS, SECONDS)
    rows = []
    for name, run in named.items():
        eps, target, us = (
            reference.errors(run, run.nx),
            metrics.target(plant, loops[name]),
            timing.quantiles(times[name]),
        )
        radius, settle_time = (metric(loops[name], target) for metric in (metrics.radius, metrics.settle_time))
        converged, settles = float(np.mean(metrics.converged(radius, target))), float(np.median(settle_time))
        largest = float(np.max(radius))
        rows.append(Compared(name, us["median_us"], us["p999_us"], eps.sup, eps.median, largest, converged, settles))
    return Comparison(tuple(rows), loops, plant.time_unit)


def _named(predictors: Any) -> dict[str, Predictor]:
    """The predictors by name: those of a list by their names, with their nodes where names repeat."""
    runs = predictors.values() if isinstance(predictors, Mapping) else predictors
    runs = [*runs] if isinstance(runs, Iterable) else [runs]
    if not runs or not all(isinstance(run, Predictor) for run in runs):
        expected = "predictors: expected a list of predictors, or a dictionary of them by name"
        raise ConfigError(f"{expected}, got {predictors!r}; make them with npred.predictor or npred.load")
    if isinstance(predictors, Mapping):
        return {str(name): run for name, run in predictors.items()}
    names = [run.name for run in runs]
    labels = [f"{run.name}, nx = {run.nx}" if names.count(run.name) > 1 else run.name for run in runs]
    if len({*labels}) < len(labels):
        raise ConfigError(f"predictors: expected different ones, got {'; '.join(labels)}; name them in a dictionary")
    return dict(zip(labels, runs, strict=True))


def _reference(plant: Plant, about: Mapping[str, Any], loops: Trajectories) -> Reference:
    """Samples of the same loops with RK4, after the longest delay; `loops` are those of some predictor."""
    batch, dt, last = loops.escaped.shape, float(loops.t[1]) / about.get("every", 1), loops.steps - 1
    D: Any = loops.D_hat if plant.declares_delay else about["D"]
    longest = array_checks.floats("D", [D(t) for t in loops.t] if callable(D) else D).max()
    steps = np.arange(last + 1)[ceil(longest / dt) + 1 :]
    if not len(steps):
        raise ConfigError(f"t_end: expected loops longer than the delay {longest:g}, got {about['t_end']:g}; raise it")
    each = max(PROBES // max(loops.escaped.size, 1), 1)
    steps = steps[np.linspace(0, len(steps) - 1, min(each, len(steps))).astype(int)]
    run = simulate(plant, RK4(plant), **about, samples=np.broadcast_to(steps, (*batch, len(steps))))
    X, u, D_hat = run.samples.X, run.samples.u, run.samples.D_hat
    t = np.broadcast_to(steps * dt, D_hat.shape)
    kept = array_checks.finite_rows(X, u, D_hat)
    if not kept.any():
        came = f"got none of {loops.escaped.size}"
        raise ConfigError(f"X0: expected a loop that stays finite with RK4, {came}; start nearer to rest")
    rows = slice(None, PROBES)
    return Reference(plant, X[kept][rows], u[kept][rows], D_hat[kept][rows], t[kept][rows])
