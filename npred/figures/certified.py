"""What is known of a network's error: the radii that its loops end at, and the bound that holds with a confidence."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from npred.figures.evaluation_data import EvaluationData
from npred.figures.figure import Figure, LegendEntry, Panel
from npred.figures.loops import ends, keys
from npred.figures.notation import common_unit, with_unit
from npred.figures.style import ROLES, Axes, LineStyle, log, look, short
from npred.plants import Plant
from npred.results import Certified, PredictorId
from npred.results.evaluate import Scores


def certificate(evidence: EvaluationData) -> Figure:
    """Error against radius with the line of theory, the distance to the target, and W(t) [DAPF, Theorem 3]."""
    radii = {
        contender: scores
        for contender, scores in evidence.models.items()
        if 0 < scores.eps_kappa < np.inf and 0 < scores.radius.median < np.inf
    }
    gain, line, key = evidence.gain, "", ()
    if np.isfinite(gain):  # else an error that stays takes the linearised loop out of all bounds
        line = (
            f". Dotted: the radius of a constant error ε of U, {gain:.4g} ε; {gain:.4g} is the gain, the distance per ε"
        )
        key = (LegendEntry(f"constant error: {gain:.4g} ε", LineStyle("muted", (1, 2))),)
    beside = ends(evidence)
    others = "Distance and W" if len(beside) > 1 else "Distance"
    caption = (
        "Radius: where loops end (filled: median over the cases, hollow: worst; squares: stopped early) against the "
        f"error that control sees{line}. {others}: the loop of the first figure over time."
    )
    eps = with_unit("ε_{κ} on held-out samples", common_unit(evidence.plant, evidence.plant.inputs))
    panels = (Panel("radius versus ε_{κ}", _alt_radii(radii), partial(_radii, radii, gain, eps)), *beside)
    return Figure("certificate", "Error and radius", caption, panels, (*keys(evidence.loops), *key))


def certified(plant: Plant, result: Certified | None, errors: Mapping[PredictorId, np.ndarray]) -> Figure | None:
    """The share of rollouts with a larger error of U than ε, by network; None without a certificate."""
    if result is None:
        return None
    first = next(iter(result.models.values()))
    caption = (
        f"Of {first.rollouts:,} fresh rollouts the share in which the largest error of U, over inputs and over "
        f"{first.samples or 'some'} random samples of a rollout, is above ε. With a confidence "
        f"of {first.confidence:.4g}, at most a share {first.probability:.4g} of all such rollouts is above the end of "
        f"a line; crosses: the largest error that an adversary found. Dotted: the tolerance of the guard. It holds for "
        f"the distribution that rollouts are drawn from."
    )
    alt = "; ".join(f"{c.label}: at most {short(row.eps_kappa)}" for c, row in result.models.items()) + "."
    unit = with_unit("ε, of U", common_unit(plant, plant.inputs))
    panel = Panel("share of rollouts above ε", alt, partial(_exceeding, result, errors, unit))
    tolerance = LegendEntry(f"tolerance {first.tolerance:.4g}", LineStyle("muted", (1, 2)))
    return Figure("certified", "With a confidence", caption, (panel,), (*keys(result.models), tolerance))


def _exceeding(result: Certified, errors: Mapping[PredictorId, np.ndarray], unit: str, axis: Axes) -> None:
    for contender, row in result.models.items():
        ordered = np.sort(errors[contender])
        share = 1 - np.arange(len(ordered)) / len(ordered)
        axis.plot(np.where(ordered > 0, ordered, np.nan), share, **look(contender).line)
        if 0 < row.adversarial < np.inf:
            axis.plot([row.adversarial], [share[-1]], "x", color=look(contender).colour)
    tolerance = next(iter(result.models.values())).tolerance
    axis.axvline(tolerance, color=ROLES["muted"][0], linestyle=(0, (1, 2)), linewidth=1.2)
    axis.set_xlabel(unit)
    log(axis, "x", "y")


def _radii(rows: dict[PredictorId, Scores], gain: float, label: str, axis: Axes) -> None:
    for contender, row in rows.items():
        eps, median, worst = row.eps_kappa, row.radius.median, row.radius.worst
        colour, marker = look(contender).colour, "o" if contender.epoch is None else "s"
        worst = worst if 0 < worst < np.inf else np.nan
        axis.plot([eps, eps], [median, worst], "-", color=colour, linewidth=1.0)
        axis.plot([eps], [median], marker, color=colour)
        axis.plot([eps], [worst], marker, markerfacecolor=ROLES["paper"][0], markeredgecolor=colour)
    if rows and np.isfinite(gain):
        eps = [row.eps_kappa for row in rows.values()]
        span = np.array([min(eps) / 3, max(eps) * 3])
        axis.plot(span, gain * span, color=ROLES["muted"][0], linestyle=(0, (1, 2)), linewidth=1.2)
    axis.set_xlabel(label)
    log(axis, "x", "y")


def _alt_radii(rows: dict[PredictorId, Scores]) -> str:
    radii = [
        f"{contender.label}: ε_{{κ}} {row.eps_kappa:.2e}, radius from {short(row.radius.median)} (median) to "
        f"{short(row.radius.worst)} (worst)"
        for contender, row in rows.items()
    ]
    return "; ".join(radii) + "." if radii else "No network's loops stay finite."
