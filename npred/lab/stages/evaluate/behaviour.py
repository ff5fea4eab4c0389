"""What closed loops do: where and when they end, which of them converge, and which end since commands overtake."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from npred.lab.config import Evaluate
from npred.lab.config.conditions import Starts
from npred.lab.config.results import NUMERICAL, PredictorId
from npred.lab.config.results.evaluate import Behaviour, DelayMap, Limits, LoopEnd, Radii, Radius
from npred.lab.report.terminal.console import Console
from npred.loop import metrics
from npred.loop.closed_loop import Trajectories
from npred.loop.trajectory_views import infeasible
from npred.plants import Plant

SERIES = ("t", "X", "U", "D_hat", "N")  # of figure1.h5


class Overtaken(NamedTuple):
    """The number of loops that ended since commands would overtake each other, 1 - D_X f - D_t <= 0, and where.

    That is step, state and margin of the first, in words; 0 and nothing if none did.
    """

    count: int
    where: str


def overtaken(loops: Trajectories) -> Overtaken:
    return Overtaken(int((loops.infeasible >= 0).sum()), " ".join(infeasible(loops) or ()))


def warn_of_overtaken(progress: Console, by_contender: Mapping[PredictorId, Overtaken], scenario: str = "") -> None:
    """One warning for all contenders, of a scenario if one is named; none where no loop ended."""
    each = [(contender, loops) for contender, loops in by_contender.items() if loops.count]
    if each:
        counts = ", ".join(f"{loops.count} of {contender.label}" for contender, loops in each)
        where = f'in the scenario "{scenario}" ' if scenario else ""
        what = f"{where}loops in which commands would overtake each other count as lost"
        progress.warn(f"{what}: {counts}; {each[0][1].where}")


def scores(
    plant: Plant, config: Evaluate, begin: Starts, contender: PredictorId, eps_kappa: float,
    loops: Mapping[PredictorId, Trajectories],
) -> dict[str, Any]:  # fmt: skip
    """What a contender's loops of an evaluation do, by key of npred.lab.config.results.evaluate.Scores."""
    run, exact = loops[contender], loops[NUMERICAL]
    cases, reference = run.part(begin.cases), exact.part(begin.cases)
    target = plant.target(cases.t)
    settle, goal = (metrics.settle_time(batch, target) for batch in (cases, reference))
    settled = np.isfinite(goal) & (goal > 0)
    mapped = contender.adapts and begin.map.stop > begin.map.start
    return {
        "radius": Radius(**_radii(cases, target), predicted=metrics.gain(plant, config.case_t_end) * eps_kappa),
        "settle_time": np.median(settle),
        "settle_ratio": _median(settle[settled] / goal[settled]),
        "decay_rate": _median(metrics.decay_rate(cases, target)),
        "map": delay_map(plant, config, run.part(begin.map), exact.part(begin.map)) if mapped else None,
        "figure1": end(plant, figure1(config, run)),
        "fallback": run.fallback_share if config.guard and contender.is_network else None,
        **limits(cases, config.safety is not None),
    }


def behaviour(
    plant: Plant, loops: Trajectories, D: Callable[[float], float] | float, guarded: bool = False,
    filtered: bool = False,
) -> Behaviour:  # fmt: skip
    """What loops (B,) of true delay D do in a scenario."""
    target = plant.target(loops.t)
    return Behaviour(
        radius=Radii(**_radii(loops, target)),
        settle_time=np.median(metrics.settle_time(loops, target)),
        lost=int(metrics.lost(loops, target).sum()),
        overtaking=overtaken(loops).count,
        D_error=None if plant.declares_delay else _D_error(loops, D),
        fallback=loops.fallback_share if guarded else None,
        **limits(loops, filtered),
    )


def limits(loops: Trajectories, filtered: bool) -> dict[str, Limits]:
    """How loops keep the plant's limits, with a safety filter or without; empty where it declares none."""
    if loops.safety is None:
        return {}
    least, share, unkept = float(loops.safety.min()), loops.filtered_share, int(loops.unkept.sum())
    return {
        "limits": Limits(
            least=least if np.isfinite(least) else None,
            filtered=share if filtered else None,
            unkept=unkept if filtered else None,
        )
    }


def delay_map(plant: Plant, config: Evaluate, loops: Trajectories, reference: Trajectories) -> DelayMap:
    """The loops of the map D x D_hat(0) that converge, and their share of those that do with the numerical predictor.

    `band` is the range of D in which no loop is lost that converges with the numerical predictor.
    """
    shape, target = (len(config.map_D), len(config.map_D_hat0)), plant.target(loops.t)
    radii = (metrics.radius(run, target) for run in (loops, reference))
    converged, exact = (metrics.converged(each, target).reshape(shape) for each in radii)
    safe = [D for D, row, goal in zip(config.map_D, converged, exact, strict=True) if (row | ~goal).all()]
    return DelayMap(
        D=config.map_D, D_hat0=config.map_D_hat0, converged=converged.tolist(),
        share=(converged & exact).sum() / max(exact.sum(), 1), band=(min(safe), max(safe)) if safe else None,
    )  # fmt: skip


def figure1(config: Evaluate, loops: Trajectories) -> Trajectories:
    """The loop of [DAPF, Fig. 1], the first of the batch, up to t_end."""
    rows = slice(0, int(np.searchsorted(loops.t, config.t_end + 1e-9)))
    series = {name: getattr(loops, name)[0, rows] for name in ("X", "P", "U", "D_hat", "N", "energy")}
    return replace(loops, t=loops.t[rows], escaped=loops.escaped[0], **series)


def write_figure1(path: Path, config: Evaluate, *readings: Mapping[PredictorId, Trajectories]) -> None:
    """These loops as HDF5: by contender t, X, U, D_hat, and N of the stability proof; those of a second reading, with U
    within `figure_bounds`, below `bounded/`.
    """
    with h5py.File(path, "w") as file:
        for group, loops in zip(("", "bounded/"), readings, strict=False):
            for contender, run in loops.items():
                for series in SERIES:
                    file[f"{group}{contender.name}/{series}"] = getattr(figure1(config, run), series)


def end(plant: Plant, loop: Trajectories) -> LoopEnd:
    target = plant.target(loop.t)
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


def _D_error(loops: Trajectories, D: Callable[[float], float] | float) -> float | None:
    """The largest |D_hat - D| over the last tenth; None where no estimate is finite there."""
    late = loops.t >= (1 - metrics.TAIL) * loops.t[-1]
    delays = np.array([D(t) if callable(D) else D for t in loops.t[late]])
    errors = np.abs(loops.D_hat[:, late] - delays)
    return float(np.nanmax(errors)) if np.isfinite(errors).any() else None
