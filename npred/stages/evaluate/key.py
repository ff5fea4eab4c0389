"""What the key of an evaluation holds."""

from typing import Any

from npred.config import Pipeline
from npred.plants import inputs
from npred.stages.configuration import box, loop, loop_parts, networks, notation, plant, table

HELD_OUT = ("test_share", "explore", "redraw", "spread", "explore_D", "explore_D_hat0")


def configuration(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The table and the networks, what draws held-out rows, and the labels of its figures."""
    section = {"evaluate": loop(config, "evaluate")}
    if bounded := config.evaluate.bounded:
        inputs.configured(plant(config), bounded.u0, bounded.input_bounds, "evaluate")  # it may refuse them
    return section | networks(config) | box(config) | notation(config) | _held_out(config)


def parts(config: Pipeline, model: str | None) -> dict[str, str]:
    """The methods and the laws of the loops, those of scenarios too."""
    laws = {f"evaluate.scenarios[{k}]": s.adaptation or "" for k, s in enumerate(config.evaluate.scenarios)}
    return loop_parts(config, "evaluate") | laws


def _held_out(config: Pipeline) -> dict[str, Any]:
    """The settings that the evaluation draws its held-out rows by; the same data may be held out in other shares."""
    section = config.generate
    if section.data or not (section.explore or section.redraw):
        return {}
    return {"generate": {key: value for key, value in table(section).items() if key in HELD_OUT}}
