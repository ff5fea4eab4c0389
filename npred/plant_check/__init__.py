"""What is right and what is wrong with a plant, in words: asked before an hour of rollouts and training tells."""

from collections.abc import Iterator

from npred.errors import ConfigError
from npred.plant_check import box, rest
from npred.plant_check.answer import Answer, Case, settled
from npred.plants.base import Plant

__all__ = ["Answer", "Case", "check", "settled"]


def check(plant: Plant, delay: float = 1.0, nodes: int = 101, samples: int = 256) -> list[Answer]:
    """Every question about a plant with its answer, for delays up to `delay` seconds on `nodes` nodes.

    A question that needs what another one found missing is not asked. Raises ConfigError for a delay that is not
    positive, or for fewer than two nodes.
    """
    return list(_answers(Case(plant, delay, nodes, samples)))


def _answers(case: Case) -> Iterator[Answer]:
    yield (traced := _traced(case.plant))
    if traced.verdict == "no":
        return
    if case.plant.traced:
        yield rest.smooth(case)
    yield (declared := box.declared(case))
    sound = declared.verdict != "no"
    if sound:
        yield (finite := box.finite(case))
        sound = finite.verdict != "no"
    yield from rest.answers(case, sound)
    if sound:
        yield from box.answers(case)


def _traced(plant: Plant) -> Answer:
    try:
        _ = plant.identity
    except ConfigError as error:
        return Answer("trace", "no", str(error))
    found = f"{', '.join(plant.states)} driven by {', '.join(plant.inputs)}"
    if not plant.traced:
        return Answer("trace", "warn", f"{found}, by functions that are called: slower, and derivatives by differences")
    return Answer("trace", "yes", f"f, kappa and V: {found}")
