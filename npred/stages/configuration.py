"""The slices of the configuration that the keys of several stages hold."""

import math
from typing import Any

from npred import plants, registry
from npred.config import PAPER, Loop, Pipeline, Section
from npred.json_files import mapped
from npred.plants import Plant, inputs

UNUSED = 1000.0  # gamma in the key of loops without an adaptation


def plant(config: Pipeline) -> Plant:
    return plants.resolve(config.plant, config.parameters, config.kappa)


def table(section: Section) -> dict[str, Any]:
    """A table as JSON."""
    return mapped(section.model_dump(mode="json"), _word)


def loop(config: Pipeline, stage: str) -> dict[str, Any]:
    """The table of a stage that runs loops; methods and laws of files enter by what they hold, not by where they are.

    A delay law other than the paper's enters; so does an input before t = 0 other than zero, the default where the
    plant's inputs may be zero.
    """
    settings: Loop = getattr(config, stage)
    section, law = table(settings), registry.DELAY_LAWS.identity(settings.adaptation)
    u0 = inputs.configured(plant(config), settings.u0, settings.input_bounds, stage)
    section["predictor"] = registry.METHODS.identity(settings.predictor)
    section["gamma"] = gamma(config, settings)
    if settings.predictor == "semi_implicit" or stage == "evaluate":  # of which a guard may choose it
        section |= plant(config).mechanics_program
    if settings.safety or stage == "evaluate":  # which says how limits are kept, with a filter or without
        section |= plant(config).safe_program
    del section["adaptation"], section["u0"]
    section |= {} if law == PAPER else {"adaptation": law}
    for holder in [section, *section.get("scenarios", [])]:
        if observer := holder.get("observer"):
            observer["kind"] = registry.OBSERVERS.identity(observer["kind"])
            section |= plant(config).output_program
    for scenario in section.get("scenarios", []):
        scenario |= {k: registry.DELAY_LAWS.identity(v) for k, v in scenario.items() if k == "adaptation"}
    past = u0 if isinstance(u0, str) else u0.tolist() if u0.any() else None
    return section | ({} if past is None else {"u0": past})


def gamma(config: Pipeline, settings: Loop) -> float:
    """The gain of the loops; where no law runs that takes one, what older keys have in its place."""
    if settings.gamma is not None:
        return settings.gamma
    from npred.loop import delay_law

    law = delay_law.resolve(settings, plant(config))
    return UNUSED if law is None else law.gamma


def networks(config: Pipeline) -> dict[str, Any]:
    return {"train": {"models": config.train.models}}


def box(config: Pipeline) -> dict[str, Any]:
    """The ranges that the plant leaves to the pipeline; data that are simulated in them differ where they do."""
    if not config.generate.data:
        return {}
    declared = plant(config).box
    ranges = {name: ends for name, ends in table(config.generate)["box"].items() if name not in declared}
    return {"box": ranges} if ranges else {}


def notation(config: Pipeline) -> dict[str, Any]:
    """The labels of figures: other labels draw them again, and train nothing."""
    declared = plant(config).notation
    return {"notation": declared} if declared else {}


def loop_parts(config: Pipeline, *stages: str) -> dict[str, str]:
    """The numerical methods and delay laws of stages that run loops, by role."""
    return {f"{stage}.{key}": getattr(getattr(config, stage), key) for stage in stages for key in LOOP_PARTS}


LOOP_PARTS = "predictor", "adaptation"


def _word(leaf: Any) -> Any:
    """JSON has no infinity, and an input bounded on one side only has one: as text it can enter a key."""
    return str(leaf) if isinstance(leaf, float) and not math.isfinite(leaf) else leaf
