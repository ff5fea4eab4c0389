"""What is right and what is wrong with a plant, in words: asked before an hour of rollouts and training tells."""

from collections.abc import Iterator

from npred.config import Pipeline
from npred.diagnosis import box, equilibrium
from npred.diagnosis.answer import Answer, Case, asked, settled
from npred.plants.base import Plant

__all__ = ["Answer", "Case", "check", "settled"]

NODES, ASSUMED = 101, 1.0  # and seconds, where nothing says how long the delay is


def check(
    plant: Plant, delay: float | None = None, nodes: int | None = None, samples: int = 256,
    pipeline: Pipeline | None = None,
) -> list[Answer]:  # fmt: skip
    """Every question about a plant with its answer, for delays up to `delay` seconds on `nodes` nodes.

    By default the delay is the longest that the pipeline names, else the longest of the plant's, else 1 s; a pipeline
    gives nodes, box, input bounds and u0 too. A question that needs what another one found missing is not asked.
    Raises ConfigError for a delay that is not positive, or for fewer than two nodes.
    """
    longest, source = _longest(plant, pipeline) if delay is None else (delay, "as asked")
    count = nodes if nodes is not None else pipeline.generate.nx if pipeline else NODES
    return list(_answers(Case(plant, longest, count, samples, pipeline), f"{longest:g} s, {source}"))


def _longest(plant: Plant, pipeline: Pipeline | None) -> tuple[float, str]:
    """The delay to predict over, and where it is from."""
    if pipeline:
        return pipeline.longest_delay, "the longest delay or first estimate of the pipeline"
    if plant.delays:
        return max(plant.delays), "the longest of the plant's delays"
    return ASSUMED, "assumed: --delay gives another, or a pipeline in the place of the plant"


def _answers(case: Case, delay: str) -> Iterator[Answer]:
    yield (traced := asked("trace", _traced, case))
    if traced.verdict == "no":
        return
    if case.plant.traced:
        yield asked("smooth law", equilibrium.smooth, case)
    yield (declared := box.declared(case))
    sound = declared.verdict != "no"
    if sound:
        yield (finite := asked("finite", box.finite, case))
        sound = finite.verdict != "no"
    yield Answer("delay", "yes", delay)
    yield from equilibrium.answers(case, sound)
    if sound:
        yield from box.answers(case)


def _traced(case: Case) -> Answer:
    plant = case.plant
    _ = plant.identity, plant.rests  # they say so where a function fails
    found = f"{', '.join(plant.states)} driven by {', '.join(plant.inputs)}"
    if not plant.traced:
        return Answer("trace", "warn", f"{found}, by functions that are called: slower, and derivatives by differences")
    return Answer("trace", "yes", f"f, kappa and V: {found}")
