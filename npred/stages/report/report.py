"""The report stage: all results of a pipeline as one HTML file that needs nothing else, and in three sentences."""

from collections.abc import Iterable, Iterator
from typing import Any

from npred.config import FROZEN, Evaluate
from npred.figures import svg
from npred.figures.evaluation_data import OF
from npred.figures.figure import Plate
from npred.figures.latency import label
from npred.figures.notation import symbol
from npred.figures.style import short
from npred.loop import metrics
from npred.plants import Plant
from npred.registry import METHODS
from npred.results import NO_ADAPTATION, NUMERICAL, Benched, Contender, Evaluated, Reported
from npred.results.evaluate import Scores
from npred.stages.bench import timing_tables
from npred.stages.job import Job
from npred.stages.report import html_page, toml_text
from npred.stages.report.report_data import CHAPTERS, Story
from npred.terminal.console import Console
from npred.terminal.waiting import Bar, counted

NAME = "report.html"
FOLDED = "speed"  # a table that is long


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
    """The report in its sentences."""
    return "\n".join(result.summary)


def sentences(plant: Plant, evaluated: Evaluated, benched: Benched) -> list[str]:
    """A run in three sentences with their numbers: the error, the closed loop, the time of a call."""
    networks = [contender for contender in evaluated.models if contender.is_network and contender.epoch is None]
    return [_errors(evaluated, networks), _loops(plant, evaluated, networks), _speed(benched)]


def _errors(evaluated: Evaluated, networks: list[Contender]) -> str:
    rows = [(network.label, evaluated.models[network]) for network in networks]
    errors = [f"{short(row.eps_sup)} for the {name} (mean square {short(row.mse)})" for name, row in rows]
    first, *others = evaluated.kinds
    samples = f"{evaluated.held_out:,} held-out samples of {OF[first]}"
    others = [_of_kind(kind, evaluated.kinds[kind].rows, [row for _, row in rows]) for kind in others]
    return "; ".join([f"On {samples} the largest error of a prediction is {_and(errors)}", *others]) + "."


def _of_kind(kind: str, count: int, rows: Iterable[Scores]) -> str:
    return f"on {count:,} of {OF[kind]} it is {_and([short(row.kinds[kind].eps_sup) for row in rows])}"


def _and(texts: list[str]) -> str:
    """a, b and c."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if texts[1:] else texts)


def _loops(plant: Plant, evaluated: Evaluated, networks: list[Contender]) -> str:
    radii = {contender: scores.radius for contender, scores in evaluated.models.items()}
    counts = [f"{radii[n].count} with the {n.label} (median radius {short(radii[n].median)})" for n in networks]
    counts.append(f"{radii[NUMERICAL].count} with the numerical predictor")
    if adapts := NO_ADAPTATION in radii:
        counts.append(f"{radii[NO_ADAPTATION].count} without adaptation")
    delay = "with a delay that the controller does not know" if adapts else "with the delay estimate held"
    delay = "with a delay that the plant declares" if plant.declares_delay else delay
    return f"Of {radii[NUMERICAL].cases} closed loops {delay}, {_and(counts)} end {_near(plant)}."


def _near(plant: Plant) -> str:
    """Where a loop that converges ends."""
    if plant.rests:
        return f"within {short(metrics.SETTLED * metrics.size(plant.equilibrium))} of rest"
    return f"within {100 * metrics.SETTLED:g} % of the reference"


def _speed(benched: Benched) -> str:
    single = benched.table
    finest = min((row.dx for row in single), default=0.0)
    networks = [row for row in single if row.is_network and row.dx == finest]
    if not networks:
        return "No network was timed."
    row = min(networks, key=lambda row: row.median_us)
    ratio = row.speedup_published  # None where inputs have several delays, which that predictor does not take
    over = "" if ratio is None else f", {ratio:,.0f} times faster than interpreted O(nx²) sums"
    text = f"A call of the {label(row)}, takes {row.median_us:.1f} µs at dx = {finest:.3g}{over}"
    return f"{text}{_against_numerics(benched, row.predictor)}."


def _against_numerics(benched: Benched, network: str) -> str:
    crossover = next((row for row in benched.crossover if row.predictor == network), None)
    if crossover is None:
        return ""
    steps = counted(crossover.best_steps, "steps")
    return f"; {METHODS.label(crossover.best)} on {steps} is as accurate in {crossover.best_us:.1f} µs"


def _page(story: Story, said: list[str], job: Job) -> str:
    return html_page.filled(
        html_page.text("page.html"),
        name=job.config.name,
        about=_about(job),
        said=said,
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
    sensors = [f"{key} {_sensor(plant, key, value)}" for key, value in dict(config.measurement).items() if value]
    if config.actuator == "history":
        yield "actuator state not measured"
    if sensors:
        yield f"measurements with {', '.join(sensors)}"
    if config.truth or config.disturbance.amplitude:
        yield "the simulated plant is not the controller's model"


def _sensor(plant: Plant, key: str, value: float) -> str:
    """A setting of the sensors with its unit: noise, jitter and drop are shares."""
    unit = plant.time_unit if key in ("period", "delay") else "%"
    return f"{100 * value if unit == '%' else value:g}\N{NO-BREAK SPACE}{unit}".rstrip()


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
