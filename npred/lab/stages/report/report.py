"""The report stage: all results of a pipeline as one HTML file that needs nothing else."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from npred.lab.config import FROZEN, Evaluate
from npred.lab.config.results import Reported
from npred.lab.report.figures.notation import symbol
from npred.lab.scheduler.job import Job
from npred.lab.stages.bench import timing_tables
from npred.lab.stages.report import html_page, toml_text
from npred.lab.stages.report.report_data import CHAPTERS, PipelineResults, sentences
from npred.plants import Plant

NAME = "report.html"
FOLDED = "speed"  # a table that is long
POOR = 0.02  # relative L² error of a network: in pipelines that are meant to be used, less than a tenth of it


def run(job: Job) -> Reported:
    """Write report.html from what the other stages left; the same bytes for the same results.

    Inline SVG, style and script; nothing is loaded. Its three sentences are in the result.
    """
    results = PipelineResults.read(job.config, job.plant, job.inputs)
    job.progress.doing("report", "drawing")
    text = sentences(job.plant, results.evaluated, results.benched)
    page = html_page.filled(
        html_page.text("page.html"),
        name=job.config.name,
        about="; ".join(_about(job.plant, job.config.evaluate)),
        said=text,
        caution=_caution(results),
        chapters=_chapters(results),
        folded=FOLDED,
        facts=_facts(results),
        files=job.config.files,
        settings=toml_text.dumps(job.config.with_file_names().model_dump()),
    )
    (job.folder / NAME).write_text(page, encoding="utf-8")
    return Reported(summary=text, bytes=len(page.encode()))


def summary(result: Reported, width: int | None = None) -> str:
    return "\n".join(result.summary)


def _chapters(results: PipelineResults) -> list[dict[str, Any]]:
    figures, tables = results.figures(), results.tables()
    return [
        {
            "id": name,
            "title": title,
            "figures": [figures[each] for each in shown if each in figures],
            "notes": timing_tables.sentences(results.benched) if name == "speed" else [],
            "tables": [tables[each] for each in below if each in tables],
        }
        for name, title, shown, below in CHAPTERS
        if figures.keys() & {*shown}
    ]


def _caution(results: PipelineResults) -> str:
    """A sentence where no network is good, as in a pipeline that only tests the chain; empty where one is."""
    models = results.evaluated.models.items()
    errors = [scores.rel_l2 for each, scores in models if each.is_network and each.epoch is None]
    if not errors or min(errors) < POOR:
        return ""
    return (
        f"No network here predicts well: the mean error is {min(errors):.0%} of the state or more, after a training on "
        f"{results.generated.samples:,} samples. Take its numbers for a test of the program, not of networks."
    )


def _about(plant: Plant, config: Evaluate) -> Iterator[str]:
    """The plant, its delay, and what of the loop is not as in the paper."""
    states, inputs = (", ".join(symbol(plant, name) for name in names) for names in (plant.states, plant.inputs))
    yield f"{plant.name}: states {states}"
    yield f"inputs {inputs}"
    if plant.declares_delay:
        yield "a delay that the plant declares"
    else:
        estimate = "its estimate held" if config.adaptation == FROZEN else "unknown to the controller"
        yield f"delay D = {plant.time_text(config.D)}, {estimate}"
    if config.actuator == "history":
        yield "actuator state not measured"
    if config.timing:
        yield "calls of the controller that are not on time"
    if config.observer:
        yield f"the state estimated by {config.observer.kind}"
    if config.safety:
        yield f"limits kept by a filter with α = {config.safety.alpha:g}"
    settings = vars(config.measurement).items()
    if sensors := [f"{key} {_sensor(plant, key, value)}" for key, value in settings if np.any(value)]:
        yield f"measurements with {', '.join(sensors)}"
    if config.truth or config.disturbance.amplitude:
        yield "the simulated plant is not the controller's model"


def _sensor(plant: Plant, key: str, value: float | list[float]) -> str:
    """A setting of the sensors with its unit: noise, jitter and drop are shares."""
    unit = plant.time_unit if key in ("period", "delay") else "%" if key in ("noise", "jitter", "drop") else ""
    numbers = [f"{100 * number if unit == '%' else number:g}" for number in np.atleast_1d(value)]
    return f"{' / '.join(numbers)}\N{NO-BREAK SPACE}{unit}".rstrip()


def _facts(results: PipelineResults) -> dict[str, dict[str, Any]]:
    """The origin of the numbers, in three lists: the question, the results' keys, the machine that was timed."""
    config, plant, hardware = results.config, results.plant, results.benched.hardware
    parameters = {name: f"{value:g}" for name, value in plant.parameters.items()}
    data = {"samples": results.generated.samples, "rollouts": results.generated.rollouts}
    return {
        "Question": {"pipeline": config.name, "seed": config.seed, "plant": plant.name} | parameters | data,
        "Results": results.keys,
        "Machine": hardware.model_dump(exclude={"versions"}, exclude_unset=True) | hardware.versions,
    }
