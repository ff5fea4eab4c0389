"""What is known of a network's error: the radii that its loops end at, and the bound that holds with a confidence."""

from collections.abc import Mapping

import numpy as np

from npred.lab.config.results import Certified, PredictorId
from npred.lab.report.figures.evaluation_data import EvaluationData
from npred.lab.report.figures.figure import Figure, LegendEntry, Panel, legend
from npred.lab.report.figures.loops import ends
from npred.lab.report.figures.notation import common_unit, with_unit
from npred.lab.report.figures.style import DOTTED, ROLES, Axes, LineStyle, line_of, log, positive, short
from npred.plants import Plant


def certificate(evaluation: EvaluationData) -> Figure:
    """Error against radius with the line of theory, the distance to the target, and W(t) [DAPF, Theorem 3]."""
    plant, gain = evaluation.plant, evaluation.gain
    radii = {
        predictor: scores
        for predictor, scores in evaluation.models.items()
        if 0 < scores.eps_kappa < np.inf and 0 < scores.radius.median < np.inf
    }

    def draw(axis: Axes) -> None:
        for predictor, row in radii.items():
            eps, median, worst = row.eps_kappa, row.radius.median, row.radius.worst
            colour, marker = line_of(predictor).colour, "o" if predictor.epoch is None else "s"
            worst = worst if 0 < worst < np.inf else np.nan
            axis.plot([eps, eps], [median, worst], "-", color=colour, linewidth=1.0)
            axis.plot([eps], [median], marker, color=colour)
            axis.plot([eps], [worst], marker, markerfacecolor=ROLES["paper"][0], markeredgecolor=colour)
        if radii and np.isfinite(gain):
            eps = [row.eps_kappa for row in radii.values()]
            span = np.array([min(eps) / 3, max(eps) * 3])
            axis.plot(span, gain * span, **DOTTED)
        axis.set_xlabel(with_unit("ε_{κ} on held-out samples", common_unit(plant, plant.inputs)))
        log(axis, "x", "y")

    alts = [
        f"{predictor.label}: ε_{{κ}} {row.eps_kappa:.2e}, radius from {short(row.radius.median)} (median) to "
        f"{short(row.radius.worst)} (worst)"
        for predictor, row in radii.items()
    ]
    alt = "; ".join(alts) + "." if alts else "No network's loops stay finite."
    theory, entries = "", legend([*evaluation.loops])
    if np.isfinite(gain):  # else an error that stays takes the linearised loop out of all bounds
        theory = (
            f". Dotted: the radius of a constant error ε of U, {gain:.4g} ε; {gain:.4g} is the gain, the distance per ε"
        )
        entries.append(LegendEntry(f"constant error: {gain:.4g} ε", LineStyle("muted", (1, 2))))
    beside = ends(evaluation)
    others = "Distance and W" if len(beside) > 1 else "Distance"
    caption = (
        "Radius: where loops end (filled: median over the cases, hollow: worst; squares: stopped early) against the "
        f"error that control sees{theory}. {others}: the loop of the first figure over time."
    )
    panels = [Panel("radius versus ε_{κ}", alt, draw), *beside]
    return Figure("certificate", "Error and radius", caption, panels, entries)


def certified(plant: Plant, result: Certified | None, errors: Mapping[PredictorId, np.ndarray]) -> Figure | None:
    """The share of rollouts with a larger error of U than ε, by network; None without a certificate."""
    if result is None:
        return None
    first = next(iter(result.models.values()))

    def draw(axis: Axes) -> None:
        for network, row in result.models.items():
            ordered, line = np.sort(errors[network]), line_of(network)
            share = 1 - np.arange(len(ordered)) / len(ordered)
            axis.plot(positive(ordered), share, **line.line)
            if row.adversarial and row.adversarial < np.inf:
                axis.plot([row.adversarial], [share[-1]], "x", color=line.colour)
        axis.axvline(first.tolerance, **DOTTED)
        axis.set_xlabel(with_unit("ε, of U", common_unit(plant, plant.inputs)))
        log(axis, "x", "y")

    crosses = "" if first.adversarial is None else "; crosses: the largest error that an adversary found"
    caption = (
        f"Of {first.rollouts:,} fresh rollouts the share in which the largest error of U, over inputs and over "
        f"{first.samples or 'some'} random samples of a rollout, is above ε. With a confidence "
        f"of {first.confidence:.4g}, at most a share {first.probability:.4g} of all such rollouts is above the end of "
        f"a line{crosses}. Dotted: the tolerance of the guard. It holds for "
        f"the distribution that rollouts are drawn from."
    )
    alt = "; ".join(f"{network.label}: at most {short(row.eps_kappa)}" for network, row in result.models.items()) + "."
    tolerance = LegendEntry(f"tolerance {first.tolerance:.4g}", LineStyle("muted", (1, 2)))
    panels = [Panel("share of rollouts above ε", alt, draw)]
    return Figure("certified", "With a confidence", caption, panels, [*legend([*result.models]), tolerance])
