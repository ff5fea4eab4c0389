"""What a certificate says: the errors of fresh rollouts, and the bound that holds with a confidence."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from npred.figures.figure import Key, Panel, Plate
from npred.figures.loops import keys
from npred.figures.notation import common_unit, with_unit
from npred.figures.style import ROLES, Look, log, look, short
from npred.plants import Plant
from npred.results import Certified, Contender


def certified(plant: Plant, result: Certified | None, errors: Mapping[Contender, np.ndarray]) -> Plate | None:
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
    tolerance = Key(f"tolerance {first.tolerance:.4g}", Look("muted", (1, 2)))
    return Plate("certified", "With a confidence", caption, (panel,), (*keys(result.models), tolerance))


def _exceeding(result: Certified, errors: Mapping[Contender, np.ndarray], unit: str, axis: Any) -> None:
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
