"""The report stage: all results of a pipeline as one HTML file that needs nothing else."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from npred.config import FROZEN, Evaluate
from npred.figures import svg
from npred.figures.figure import Plate
from npred.figures.notation import symbol
from npred.plants import Plant
from npred.results import Reported
from npred.stages.bench import timing_tables
from npred.stages.job import Job
from npred.stages.report import html_page, toml_text
from npred.stages.report.report_data import CHAPTERS, Story, sentences
from npred.terminal.console import Console
from npred.terminal.waiting import Bar

NAME = "report.html"
FOLDED = "speed"  # a table that is long
POOR = 0.02  # relative L² error of a network: in pipelines that are meant to be used, less than a tenth of it


def run(job: Job) -> Reported:
    """Write report.html from what the other stages left; the same bytes for the same results.

    Inline SVG, style and script; nothing is loaded. Its three sentences are in the result.
    """
    story = Story.read(job.config, job.plant, job.inputs)
    said = sentences(job.plant, story.evaluated, story.benched)
    page = _page(story, said, job)
    (job.folder / NAME).write_text(page, encoding="utf-8")
    return Reported(summary=said, bytes=len(page.encode()))


def summary(result: Reported, width: int | None = None) -> str:
    return "\n".join(result.summary)


def _page(story: Story, said: list[str], job: Job) -> str:
    return html_page.filled(
        html_page.text("page.html"),
        name=job.config.name,
        about=_about(job),
        said=said,
        caution=_caution(story),
        chapters=list(_chapters(story, job.progress)),
        folded=FOLDED,
        facts=_facts(story, job),
        files=job.config.files,
        settings=toml_text.dumps(job.config.beside().model_dump()),
    )


def _chapters(story: Story, progress: Console) -> Iterator[dict[str, Any]]:
    plates, tables = story.plates(), story.tables()
    with progress.bar("report", sum(len(plate.panels) for plate in plates.values()), "panels") as bar:
        for name, title, shown, below in CHAPTERS:
            drawn = [(plates[p], _pictures(plates[p], bar)) for p in shown if p in plates]
            if drawn:
                notes = timing_tables.sentences(story.benched) if name == "speed" else []
                yield {
                    "id": name,
                    "title": title,
                    "plates": drawn,
                    "notes": notes,
                    "tables": [tables[t] for t in below if t in tables],
                }


def _pictures(plate: Plate, bar: Bar) -> list[str]:
    pictures = []
    for number, panel in enumerate(plate.panels):
        pictures.append(svg.inline(panel, f"{plate.name}-{number}"))
        bar.advance()
    return pictures


def _caution(story: Story) -> str:
    """A sentence where no network is good, as in a pipeline that only tests the chain; empty where one is."""
    errors = [scores.rel_l2 for c, scores in story.evaluated.models.items() if c.is_network and c.epoch is None]
    if not errors or min(errors) < POOR:
        return ""
    return (
        f"No network here predicts well: the mean error is {min(errors):.0%} of the state or more, after a training on "
        f"{story.generated.samples:,} samples. Take its numbers for a test of the program, not of networks."
    )


def _about(job: Job) -> str:
    plant, config = job.plant, job.config.evaluate
    states, inputs = (", ".join(symbol(plant, name) for name in names) for names in (plant.states, plant.inputs))
    return "; ".join(
        [f"{plant.name}: states {states}", f"inputs {inputs}", _delay(plant, config), *_reality(plant, config)]
    )


def _delay(plant: Plant, config: Evaluate) -> str:
    if plant.declares_delay:
        return "a delay that the plant declares"
    estimate = "its estimate held" if config.adaptation == FROZEN else "unknown to the controller"
    return f"delay D = {plant.time_text(config.D)}, {estimate}"


def _reality(plant: Plant, config: Evaluate) -> Iterator[str]:
    """What of the loop is not as in the paper."""
    sensors = [
        f"{key} {_sensor(plant, key, value)}" for key, value in vars(config.measurement).items() if np.any(value)
    ]
    if config.actuator == "history":
        yield "actuator state not measured"
    if config.timing:
        yield "calls of the controller that are not on time"
    if config.observer:
        yield f"the state estimated by {config.observer.kind}"
    if config.safety:
        yield f"limits kept by a filter with α = {config.safety.alpha:g}"
    if sensors:
        yield f"measurements with {', '.join(sensors)}"
    if config.truth or config.disturbance.amplitude:
        yield "the simulated plant is not the controller's model"


def _sensor(plant: Plant, key: str, value: float | list[float]) -> str:
    """A setting of the sensors with its unit: noise, jitter and drop are shares."""
    unit = plant.time_unit if key in ("period", "delay") else "%" if key in ("noise", "jitter", "drop") else ""
    numbers = [f"{100 * number if unit == '%' else number:g}" for number in np.atleast_1d(value)]
    return f"{' / '.join(numbers)}\N{NO-BREAK SPACE}{unit}".rstrip()


def _facts(story: Story, job: Job) -> dict[str, dict[str, Any]]:
    """The origin of the numbers, in three lists: the question, the results' keys, the machine that was timed."""
    hardware = story.benched.hardware
    plant = {"plant": job.plant.name} | {name: f"{value:g}" for name, value in job.plant.parameters.items()}
    data = {"samples": story.generated.samples, "rollouts": story.generated.rollouts}
    return {
        "Question": {"pipeline": job.config.name, "seed": job.config.seed} | plant | data,
        "Results": story.keys,
        "Machine": hardware.model_dump(exclude={"versions"}, exclude_unset=True) | hardware.versions,
    }
