"""The cases under other conditions: radius, settling time and delay error of each scenario, the predictors beside."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from npred.figures.figure import Panel, Plate
from npred.figures.loops import keys
from npred.figures.notation import common_unit, timed, with_unit
from npred.figures.style import log, look, short
from npred.plants import Plant
from npred.results import Contender
from npred.results.evaluate import Behaviour, Conditions

Values = dict[Contender, np.ndarray]  # one per scenario
SPREAD = 0.5  # of a scenario's room, between its first and its last predictor


def scenarios(plant: Plant, conditions: Sequence[Conditions]) -> Plate | None:
    """A panel each for the worst radius, the settling time and |D_hat - D|; None where there are no scenarios."""
    if not conditions:
        return None
    panels = [
        _panel(with_unit("worst radius", common_unit(plant, plant.states)), conditions, lambda b: b.radius.worst, True),
        _panel(timed(plant, "settles after"), conditions, lambda b: b.settle_time, False),
    ]
    if not plant.declares_delay:
        panels.append(_panel(timed(plant, "|D̂ − D| at the end"), conditions, lambda b: b.D_error, True))
    lost = {c: sum(one.models[c].lost for one in conditions) for c in conditions[0].models}
    caption = (
        f"The cases again under {len(conditions)} other conditions, each predictor from the same states with the same "
        f"noise. What is infinite, of a loop that diverges or does not settle, has no mark. Lost loops: "
        f"{', '.join(f'{c.label} {count}' for c, count in lost.items())}."
    )
    return Plate("scenarios", "Other conditions", caption, tuple(panels), keys(conditions[0].models))


def _panel(
    title: str, conditions: Sequence[Conditions], value: Callable[[Behaviour], float | None], logarithmic: bool
) -> Panel:
    names, contenders = [one.name for one in conditions], list(conditions[0].models)
    by_contender = {
        c: np.array([np.nan if (v := value(one.models[c])) is None else v for one in conditions], dtype=float)
        for c in contenders
    }
    return Panel(title, _alt(names, by_contender), partial(_marks, names, by_contender, logarithmic))


def _alt(names: Sequence[str], values: Values) -> str:
    rows = [
        f"{name}: {', '.join(f'{c.label} {short(series[k])}' for c, series in values.items())}"
        for k, name in enumerate(names)
    ]
    return f"{'; '.join(rows)}."


def _marks(names: Sequence[str], values: Values, logarithmic: bool, axis: Any) -> None:
    """A mark per predictor on the line of each scenario, the first scenario on top."""
    offsets = np.linspace(-SPREAD / 2, SPREAD / 2, len(values)) if len(values) > 1 else [0.0]
    for offset, (contender, series) in zip(offsets, values.items(), strict=True):
        shown = np.where(np.isfinite(series) & ((series > 0) | (not logarithmic)), series, np.nan)
        axis.plot(shown, np.arange(len(names)) + offset, "o", color=look(contender).colour)
    axis.set(yticks=range(len(names)), yticklabels=list(names), ylim=(len(names) - 0.5, -0.5))
    if logarithmic:
        log(axis, "x")
        axis.xaxis.get_major_locator().set_params(numticks=4)  # beside the names there is little room
    else:
        axis.set_xlim(left=0)
