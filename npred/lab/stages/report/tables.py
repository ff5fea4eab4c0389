"""The tables of results, for the report, papers and the terminal."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from npred.base.registry import NETWORKS
from npred.lab.config.results import NUMERICAL, Certified, Evaluated, PredictorId, Trained
from npred.lab.config.results.bench import CallTimes
from npred.lab.config.results.evaluate import Coverage, Scores
from npred.lab.report.figures.evaluation_data import OF
from npred.lab.report.figures.latency import label
from npred.lab.report.figures.table import Column, Table
from npred.plants import Plant
from npred.plants.notation import quantity, timed

ERRORS = {"mse": "mean square", "eps_sup": "ε sup", "eps_kappa": "ε_{κ}", "rel_l2": "relative L²"}
ABOUT = {
    "mse": "mean of (P̂ − P)² over samples, x and states",
    "eps_sup": "largest |P̂ − P|",
    "eps_kappa": "largest error of U, |κ(P̂(1)) − κ(P(1))|",
    "rel_l2": "mean of ‖P̂ − P‖ / ‖P‖",
    "median": "distance from the goal over the last tenth of a loop, its median over the cases",
    "worst": "the largest of them",
    "predicted": "the gain times ε_{κ}: the distance that a small constant error of that size brings",
    "radius": "of the loop in the figure above",
    "far": "loops that overflow, or end farther from rest than a fifth of its size",
    "settle_time": "median over the cases",
    "D_error": "largest over the last tenth and the cases",
    "fallback": "share of steps in which the guard let the numerical predictor answer",
    "p95_us": "quantile of the calls, µs",
    "p999_us": "quantile of the calls, µs",
    "speedup_published": "times as fast as interpreted O(nx²) sums on the same dx",
    "speedup_compiled": "times as fast as compiled Euler on the same dx",
}  # below a table: the meaning of these headings
CERTIFIED = {
    "median": "of the largest error of U of each rollout",
    "adversarial": "largest error of U that a search found",
    "above": "calls of the search whose error of U is above the tolerance of the guard",
    "unnoticed": "of these, those that the guard lets pass",
    "blind": "calls of a search for inputs that the guard lets pass, with an error above the tolerance",
    "far": "loops that overflow or end farther from rest than a fifth of its size, and by numerical prediction do not",
    "far_guarded": "the same with the guarded network",
    "fallback": "share of the guarded loops' steps in which the numerical predictor answered",
    "bounded": "share of the worst samples that have a bound",
}
TIMES = {"median_us": "median µs", "p95_us": "95 %", "p999_us": "99.9 %", "max_us": "max"}


def predictors(evaluated: Evaluated, microseconds: Mapping[PredictorId, float] | None = None) -> Table:
    """Each predictor's largest error, worst radius and number of loops that converge; and the time of a call, if given.

    Errors are against the numerical predictor: where it predicts, there is none.
    """
    rows = list(evaluated.models.values())
    columns = [
        Column("predictor", [each.label for each in evaluated.models]),
        Column("ε sup", [row.eps_sup or None for row in rows], digits=2),
        Column("worst radius", [row.radius.worst for row in rows], digits=2),
        Column("converged", [f"{row.radius.count} of {row.radius.cases}" for row in rows], "s"),
    ]
    if limits := [row.limits for row in rows if row.limits]:
        columns.append(Column("least h", ["overflow" if h.least is None else f"{h.least:.3g}" for h in limits], "s"))
    if microseconds is not None:
        columns.append(Column("µs per call", [microseconds.get(each) for each in evaluated.models], ".1f"))
    return Table("predictors", "Predictors", columns)


def accuracy(evaluated: Evaluated) -> Table:
    """Errors of each network on held-out rows of the first kind, and on fresh ones."""
    networks = {each.label: scores for each, scores in evaluated.models.items() if each.is_network}
    fresh = [scores.fresh for scores in networks.values()]
    columns = [
        Column("predictor", list(networks)),
        *_columns(networks.values(), ERRORS),
        Column("mean square, fresh rollouts", [errors.mse for errors in fresh], digits=2),
        Column("ε sup, fresh rollouts", [errors.eps_sup for errors in fresh], digits=2),
    ]
    return Table("accuracy", f"Errors on held-out samples of {OF[evaluated.held_out_kind]}", columns)


def kinds(evaluated: Evaluated) -> Table | None:
    """Errors of each network on held-out rows of each kind; None where there is one kind, which `accuracy` has."""
    if len(evaluated.kinds) == 1:
        return None
    cells = [
        (each.label, kind, errors)
        for each, scores in evaluated.models.items()
        if each.is_network
        for kind, errors in scores.kinds.items()
    ]
    columns = [
        Column("predictor", [predictor for predictor, _, _ in cells]),
        Column("held out", [OF[kind] for _, kind, _ in cells]),
        Column("samples", [evaluated.kinds[kind].rows for _, kind, _ in cells], ",d"),
        *_columns([errors for _, _, errors in cells], ERRORS),
        Column(f"above ε sup of {OF[evaluated.held_out_kind]}", [errors.above for _, _, errors in cells], ".1%"),
    ]
    return Table("kinds", "Errors by kind of row", columns)


def loops(evaluated: Evaluated) -> Table:
    """Convergence, radius and end of the closed loops of each predictor."""
    exact, rows = evaluated.models[NUMERICAL], list(evaluated.models.values())
    about = "loops of the map of D and D̂(0) that converge, of those that do with the numerical predictor"
    shared = [_both_converge(scores, exact) for scores in rows]
    mapped = [Column(f"map, of {_both_converge(exact, exact)}", shared, "d", about=about)]
    bounded, within = [scores.figure1_bounded for scores in rows], "of the loop shown with U within figure_bounds"
    settles = "settling time over the numerical predictor's, the median over the cases"
    D, acts = ("D", "σ(t)") if evaluated.in_loop.D is None else ("D̂", "t + D")  # a declared delay is no estimate
    in_loop = [scores.in_loop if each.adapts else None for each, scores in evaluated.models.items()]
    checked = f"largest error of the prediction in {evaluated.in_loop.loops} other loops"
    if evaluated.in_loop.D is not None:
        checked += ", in which D̂ = D throughout, from t = 2D on: before, u has the jump of its start, which costs more"
    radii = {"median": "radius, median", "worst": "worst", "predicted": "from ε_{κ}"}
    columns = [
        Column("predictor", [each.label for each in evaluated.models]),
        *_columns([scores.radius for scores in rows], radii),
        Column(f"converged of {exact.radius.cases}", [scores.radius.count for scores in rows], "d"),
        Column("settles ×", [scores.settle_ratio for scores in rows], ".2f", about=settles),
        *(mapped if exact.map else []),
        *_columns([scores.figure1 for scores in rows], {"radius": "radius, loop shown"}),
        Column(f"{D} at its end", [scores.figure1.D_hat_end for scores in rows], ".3f"),
        Column("radius, U bounded", [end and end.radius for end in bounded], digits=2, about=within),
        Column(f"{D} at the end of that", [end and end.D_hat_end for end in bounded], ".3f"),
        Column(f"sup |P(1, t) − X({acts})|", in_loop, digits=2, about=checked),
        *_interventions(rows),
    ]
    return Table("loops", "Closed loops", [column for column in columns if any(v is not None for v in column.values)])


def scenarios(plant: Plant | None, evaluated: Evaluated) -> Table | None:
    """The loops of each scenario; None without scenarios. Without the plant, times have no unit."""
    rows = [(scenario, c.label, does) for scenario in evaluated.scenarios for c, does in scenario.models.items()]
    if not rows:
        return None
    does = [row[2] for row in rows]
    times = {"settle_time": "settles after", "D_error": "|D̂ − D|"}
    if evaluated.in_loop.D is None:  # the plant declares its delay, and nothing is estimated
        del times["D_error"]
    columns = [
        Column("scenario", [scenario.name for scenario, _, _ in rows]),
        Column("predictor", [label for _, label, _ in rows]),
        *_columns([each.radius for each in does], {"median": "radius, median", "worst": "worst"}),
        Column(f"converged of {does[0].radius.cases}", [each.radius.count for each in does], "d"),
        *_columns(does, {"far": "ends far"}, "d"),
        *_columns(does, {key: timed(plant, head) if plant else head for key, head in times.items()}),
        *_interventions(does),
    ]
    return Table("scenarios", "The cases under other conditions", columns)


def _interventions(rows: Sequence[Any]) -> list[Column]:
    """The share of steps in which the numerical predictor answered, where networks are guarded; how the limits of a
    plant that declares any are kept, and the work of a safety filter.
    """
    guarded, limits = any(row.fallback is not None for row in rows), [row.limits for row in rows if row.limits]
    columns = _columns(rows, {"fallback": "fallback"}, ".2%") if guarded else []
    columns += _columns(limits, {"least": "least h"}, digits=3) if limits else []
    if any(each.filtered is not None for each in limits):
        columns += _columns(limits, {"filtered": "filtered"}, ".2%")
        columns += _columns(limits, {"unkept": "steps without a plan"}, "d")
    return columns


def _both_converge(scores: Scores, exact: Scores) -> int | None:
    """How many loops of the map converge with this predictor and with the numerical one."""
    if scores.map is None or exact.map is None:
        return None
    return int((np.array(scores.map.converged) & np.array(exact.map.converged)).sum())


def certified(result: Certified) -> Table:
    """Each network's error of U, and its loops."""
    rows = list(result.models.values())
    heads = {"eps_kappa": "ε_{κ} of all rollouts", "median": "median"}
    counts = {"far": "ends far", "far_guarded": "guarded"}
    if rows[0].adversarial is not None:
        heads["adversarial"] = "adversary"
        counts = {"above": "calls above the tolerance", "unnoticed": "unnoticed", "blind": "blind spots"} | counts
    columns = [
        Column("network", [network.label for network in result.models]),
        *_columns(rows, heads, about=CERTIFIED),
        *_columns(rows, counts, ",d", about=CERTIFIED),
        *_columns(rows, {"fallback": "fallback"}, ".2%", about=CERTIFIED),
    ]
    if any(row.bound for row in rows):
        medians = [row.bound[1] if row.bound else None for row in rows]
        columns.append(Column("bound / error", medians, ".3f", about="the median over these samples"))
        columns += _columns(rows, {"bounded": "bounded"}, ".1%", about=CERTIFIED)
    sampled = f"{rows[0].rollouts:,} rollouts of {rows[0].samples or 'some'} samples each"
    return Table("certified", f"Certificate, with {sampled} and {result.loops:,} loops", columns)


def training(trained: Mapping[str, Trained]) -> Table:
    """The size of each network and how it was trained."""
    counts = {name: name for name in ("parameters", "samples", "epochs")}
    columns = [Column("network", [NETWORKS.label(name) for name in trained])]
    columns += [*_columns(trained.values(), counts, ",d"), *_columns(trained.values(), {"loss": "last loss"})]
    return Table("training", "Training", columns)


def speed(rows: Sequence[CallTimes], wide: bool = True, front: bool = False) -> Table:
    """Every row of the benchmark; `front` also those that only a figure needs, without `wide` no tails and ratios."""
    rows = [row for row in rows if front or row.matches != "front"]
    names = [
        label(row) if row.matches in (None, "front") else f"{label(row)} (ε of {NETWORKS.label(row.matches)})"
        for row in rows
    ]
    ratios = {"speedup_published": "× O(nx²) sums", "speedup_compiled": "× Euler"} if wide else {}
    columns = [
        Column("predictor", names),
        Column("dx", [row.dx for row in rows], ".3g"),
        Column("batch", [row.batch for row in rows], "d"),
        *_columns(rows, TIMES if wide else {"median_us": "median µs"}, digits=3),
        *_columns(rows, {"eps_sup": "ε sup", "eps_median": "ε median"}, digits=2),
        *_columns(rows, ratios, digits=3),
    ]
    return Table("speed", "Time of a call", columns)


def by_dx(rows: Iterable[CallTimes]) -> Table:
    """Table I of [DAPF]: median and error at batch 1, a pair of columns for each dx."""
    single = {(label(row), row.dx): row for row in rows if row.batch == 1 and row.matches is None}
    names = list(dict.fromkeys(name for name, _ in single))
    columns = [Column("predictor", names)]
    for dx in sorted({dx for _, dx in single}, reverse=True):
        at_dx = [single.get((name, dx)) for name in names]
        columns.append(Column(f"µs, dx = {dx:.3g}", [row and row.median_us for row in at_dx], digits=3))
        columns.append(Column("ε sup", [row and row.eps_sup for row in at_dx], digits=2))
    return Table("bench", "Median of a call by dx", columns)


def outside(plant: Plant, coverage: Mapping[str, Coverage]) -> Table:
    """The range of the data, and the share of each network's loop steps outside it."""
    covers = list(coverage.values())
    columns = [
        Column("quantity", [quantity(plant, name) for name in coverage]),
        Column("data from", [cover.data[0] for cover in covers], digits=3),
        Column("to", [cover.data[1] for cover in covers], digits=3),
        *(Column(f"outside, {c.label}", [cover.outside[c] for cover in covers], ".2%") for c in covers[0].outside),
    ]
    return Table("coverage", "Loops outside the data", columns)


def _columns(
    rows: Iterable[Any], heads: Mapping[str, str], form: str = "", digits: int = 2, about: Mapping[str, str] = ABOUT
) -> list[Column]:
    """The attributes of these names, a column each."""
    rows, digits = list(rows), 0 if form else digits
    return [
        Column(head, [getattr(row, key) for row in rows], form, digits, about.get(key, ""))
        for key, head in heads.items()
    ]
