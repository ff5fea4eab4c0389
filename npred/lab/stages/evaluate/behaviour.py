"""Closed loops: their ends, those that converge, the same under the conditions of scenarios, and coverage by the data.

A network is only reliable where it was trained.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred.lab.config import Evaluate
from npred.lab.config.conditions import EVERY, Condition, Starts, under
from npred.lab.config.results import NUMERICAL, PredictorId
from npred.lab.config.results.evaluate import Behaviour, Conditions, Coverage, DelayMap, Limits, LoopEnd, Radii, Radius
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.job import Job
from npred.lab.training.data.dataset import Dataset
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.loop.trajectory_views import infeasible
from npred.plants import Plant
from npred.prediction.methods import Predictor

SERIES = ("t", "X", "U", "D_hat", "N")  # in figure1.h5
MARGIN = 1e-3  # share of a quantity's range: beyond it a loop is outside
NEAR = 0.05  # share of the bounds' width: data that come this close to a bound of D_hat reach it
OUTSIDE = 0.01  # share of a predictor's loop steps outside the data, above which a line warns
BINS = 60


Overtaken = tuple[int, str]  # number of loops that ended since commands would overtake each other, and where the first


def overtaken(loops: Trajectories) -> Overtaken:
    """The number of loops with 1 - D_X f - D_t <= 0, and step, state and margin of the first in words."""
    return int((loops.infeasible >= 0).sum()), " ".join(infeasible(loops) or ())


def warn_of_overtaken(progress: Console, ended: Mapping[PredictorId, Overtaken], scenario: str = "") -> None:
    """One warning for all predictors, of a scenario if one is named; none where no loop ended."""
    marked = {predictor_id: each for predictor_id, each in ended.items() if each[0]}
    if marked:
        counts = ", ".join(f"{count} of {predictor_id.label}" for predictor_id, (count, _) in marked.items())
        where = f'in the scenario "{scenario}" ' if scenario else ""
        first = next(iter(marked.values()))[1]
        progress.warn(
            f"{where}loops in which commands would overtake each other count as far from rest: {counts}; {first}"
        )


def scores(
    plant: Plant, config: Evaluate, begin: Starts, predictor_id: PredictorId, eps_kappa: float,
    loops: Mapping[PredictorId, Trajectories],
) -> dict[str, Any]:  # fmt: skip
    """A predictor's loops of an evaluation in numbers, by key of npred.lab.config.results.evaluate.Scores."""
    run, exact = loops[predictor_id], loops[NUMERICAL]
    cases, reference = run.part(begin.cases), exact.part(begin.cases)
    target = metrics.target(plant, cases)
    settle, goal = (metrics.settle_time(batch, target) for batch in (cases, reference))
    settled = np.isfinite(goal) & (goal > 0)
    mapped = predictor_id.adapts and begin.map.stop > begin.map.start
    return {
        "radius": Radius(**_radii(cases, target), predicted=metrics.gain(plant, config.case_t_end) * eps_kappa),
        "settle_time": np.median(settle),
        "settle_ratio": _median(settle[settled] / goal[settled]),
        "decay_rate": _median(metrics.decay_rate(cases, target)),
        "map": delay_map(plant, config, run.part(begin.map), exact.part(begin.map)) if mapped else None,
        "figure1": end(plant, figure1(config, run)),
        "fallback": run.fallback_share if config.guard and predictor_id.is_network else None,
        **limits(cases, config.safety is not None),
    }


def behaviour(
    plant: Plant, loops: Trajectories, D: Callable[[float], float] | float, guarded: bool = False,
    filtered: bool = False,
) -> Behaviour:  # fmt: skip
    """The loops (B,) of a scenario with the true delay D, in numbers."""
    target, D_error = metrics.target(plant, loops), None
    late = loops.t >= (1 - metrics.TAIL) * loops.t[-1]
    if not plant.declares_delay and np.isfinite(loops.D_hat[:, late]).any():  # else there is no estimate, or none left
        D_error = float(np.nanmax(np.abs(loops.D_hat[:, late] - [D(t) if callable(D) else D for t in loops.t[late]])))
    return Behaviour(
        radius=Radii(**_radii(loops, target)),
        settle_time=np.median(metrics.settle_time(loops, target)),
        far=int(metrics.far(loops, target).sum()),
        overtaking=overtaken(loops)[0],
        D_error=D_error,
        fallback=loops.fallback_share if guarded else None,
        **limits(loops, filtered),
    )


def limits(loops: Trajectories, filtered: bool) -> dict[str, Limits]:
    """How loops keep the plant's limits, with a safety filter or without; empty where it declares none."""
    if loops.safety is None:
        return {}
    least = float(loops.safety.min())
    share, unkept = (loops.filtered_share, int(loops.unkept.sum())) if filtered else (None, None)
    return {"limits": Limits(least=least if np.isfinite(least) else None, filtered=share, unkept=unkept)}


def delay_map(plant: Plant, config: Evaluate, loops: Trajectories, reference: Trajectories) -> DelayMap:
    """The loops of the map D x D_hat(0) that converge, and their share of those that do with the numerical predictor.

    `band` is the range of D in which every loop converges that does so with the numerical predictor.
    """
    shape, target = (len(config.map_D), len(config.map_D_hat)), metrics.target(plant, loops)
    radii = (metrics.radius(run, target) for run in (loops, reference))
    converged, exact = (metrics.converged(each, target).reshape(shape) for each in radii)
    safe = [D for D, row, goal in zip(config.map_D, converged, exact, strict=True) if (row | ~goal).all()]
    return DelayMap(
        D=config.map_D, D_hat=config.map_D_hat, converged=converged.tolist(),
        share=(converged & exact).sum() / max(exact.sum(), 1), band=(min(safe), max(safe)) if safe else None,
    )  # fmt: skip


def figure1(config: Evaluate, loops: Trajectories) -> Trajectories:
    """The loop of [DAPF, Fig. 1], the first of the batch, up to t_end."""
    rows = slice(0, int(np.searchsorted(loops.t, config.t_end + 1e-9)))
    series = {name: getattr(loops, name)[0, rows] for name in ("X", "P", "U", "D_hat", "N", "energy")}
    series |= {} if loops.target is None else {"target": loops.target[rows]}
    return replace(loops, t=loops.t[rows], escaped=loops.escaped[0], **series)


def write_figure1(path: Path, config: Evaluate, *readings: Mapping[PredictorId, Trajectories]) -> None:
    """These loops as HDF5: by predictor t, X, U, D_hat, and N of the stability proof; those of a second reading, with U
    within `figure_bounds`, below `bounded/`.
    """
    with h5py.File(path, "w") as file:
        for group, loops in zip(("", "bounded/"), readings, strict=False):
            for predictor_id, run in loops.items():
                for series in SERIES:
                    file[f"{group}{predictor_id.name}/{series}"] = getattr(figure1(config, run), series)


def end(plant: Plant, loop: Trajectories) -> LoopEnd:
    target = metrics.target(plant, loop)
    radius, settle_time = float(metrics.radius(loop, target)), float(metrics.settle_time(loop, target))
    return LoopEnd(X_end=loop.X[-1].tolist(), D_hat_end=loop.D_hat[-1], radius=radius, settle_time=settle_time)


def _radii(loops: Trajectories, target: np.ndarray) -> dict[str, Any]:
    """How near to the target loops end, by key of Radii."""
    radii = metrics.radius(loops, target)
    converged = metrics.converged(radii, target).mean()
    return {"median": np.median(radii), "worst": radii.max(), "converged": converged, "cases": len(radii)}


def _median(values: np.ndarray) -> float | None:
    """The median without NaN; None where nothing is left, or most are infinite."""
    numbers = values[~np.isnan(values)]
    return float(np.median(numbers)) if len(numbers) and np.isfinite(np.median(numbers)) else None


def run_scenarios(job: Job, predictors: Mapping[PredictorId, Predictor]) -> list[Conditions]:
    """Each scenario with the numerical predictor and the final weights of each network: the same starts and noise.

    Warns of loops that ended since commands would overtake each other.
    """
    config = job.config.evaluate
    compared = {c: predictor for c, predictor in predictors.items() if c.adapts and c.epoch is None}
    conditions = [under(job.plant, job.config, scenario) for scenario in config.scenarios]
    steps = len(compared) * sum(condition.steps for condition in conditions)

    def does(condition: Condition, predictor: Predictor) -> tuple[Behaviour, Overtaken]:
        loops = condition.loops(job.plant, predictor, every=EVERY, progress=bar.advance)
        filtered = condition.table.safety is not None
        return behaviour(job.plant, loops, condition.D, predictor.guard is not None, filtered), overtaken(loops)

    with job.progress.bar("scenarios", steps, "steps") as bar, job.threads() as pool:
        tasks = [{c: pool.submit(does, each, p) for c, p in compared.items()} for each in conditions]
        results = [{c: task.result() for c, task in by_predictor.items()} for by_predictor in tasks]
    outcomes = []
    for scenario, by_predictor in zip(config.scenarios, results, strict=True):
        warn_of_overtaken(job.progress, {c: ended for c, (_, ended) in by_predictor.items()}, scenario.name)
        outcomes.append(Conditions(name=scenario.name, models={c: loops for c, (loops, _) in by_predictor.items()}))
    return outcomes


def _quantities(plant: Plant, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray) -> dict[str, np.ndarray]:
    """The values of each state, each input and the delay estimate, flat, without what overflowed."""
    by_name = {name: X[..., k] for k, name in enumerate(plant.states)}
    by_name |= {name: u[..., k] for k, name in enumerate(plant.inputs)} | {"D_hat": D_hat}
    return {name: values[np.isfinite(values)] for name, values in by_name.items()}


def coverage(
    plant: Plant, data: Dataset, loops: Mapping[PredictorId, Trajectories], bounds: tuple[float, float] = (0.0, np.inf)
) -> dict[str, Coverage]:
    """For each quantity its range in the training data, and the share of each predictor's loop steps outside it.

    An estimate at its bound is inside where the data come near that bound: they cannot lie beyond, and what is drawn
    up to a bound does not meet it.
    """
    covered = _quantities(plant, data.X, data.u, data.D_hat)
    ranges = {name: (float(values.min()), float(values.max())) for name, values in covered.items()}
    near, ends = NEAR * (bounds[1] - bounds[0]), zip(ranges["D_hat"], bounds, strict=True)
    reached: dict[str, Any] = {"D_hat": [bound if abs(end - bound) <= near < np.inf else end for end, bound in ends]}
    outside: dict[str, dict[PredictorId, float]] = {name: {} for name in ranges}
    for predictor_id, run in loops.items():
        for name, values in _quantities(plant, run.X, run.U, run.D_hat).items():
            low, high = reached.get(name, ranges[name])
            slack = MARGIN * (high - low)
            outside[name][predictor_id] = float(np.mean((values < low - slack) | (values > high + slack)))
    return {name: Coverage(data=ranges[name], outside=outside[name]) for name in ranges}


def write_coverage(path: Path, plant: Plant, data: Dataset, loops: Mapping[PredictorId, Trajectories]) -> None:
    """Densities over the data's range as HDF5: by quantity `edges` (BINS + 1,), `data` and `loops/NAME` (BINS,)."""
    with h5py.File(path, "w") as opened:
        file: Any = opened
        for name, values in _quantities(plant, data.X, data.u, data.D_hat).items():
            slack = MARGIN * np.ptp(values)  # the picture shows all that `coverage` counts as inside
            slack = slack or 0.01 * max(abs(values[0]), 1.0)  # a delay that is known has one value
            edges = np.linspace(values.min() - slack, values.max() + slack, BINS + 1)
            file[f"{name}/edges"], file[f"{name}/data"] = edges, np.histogram(values, edges, density=True)[0]
        for predictor_id, run in loops.items():
            for name, values in _quantities(plant, run.X, run.U, run.D_hat).items():
                edges = file[f"{name}/edges"][:]
                inside = np.histogram(values, edges)[0] / max(len(values), 1)
                file[f"{name}/loops/{predictor_id.name}"] = inside / np.diff(edges)
