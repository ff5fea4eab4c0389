"""The report stage: all results of a pipeline as one HTML file that needs nothing else, and as figures for papers."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred.base import json_files
from npred.lab.config import FROZEN, Evaluate, Pipeline, dumps
from npred.lab.config.results import (
    NO_ADAPTATION,
    NUMERICAL,
    Benched,
    Certified,
    Evaluated,
    Generated,
    PredictorId,
    Reported,
    Trained,
    ranked,
)
from npred.lab.report import figures
from npred.lab.report.figures import EvaluationData, Figure
from npred.lab.report.figures.evaluation_data import OF
from npred.lab.report.figures.latency import label
from npred.lab.report.figures.style import short
from npred.lab.report.figures.table import Table
from npred.lab.scheduler.job import Job
from npred.lab.scheduler.plan import nodes
from npred.lab.stages.bench import bench
from npred.lab.stages.evaluate import evaluate
from npred.lab.stages.report import UNFINISHED, html_page, tables
from npred.loop import metrics
from npred.plants import Plant
from npred.plants.notation import symbol

NAME = "report.html"
FOLDED = "speed"  # a table that is long
CHAPTERS = (
    ("loop", "The closed loop", ("figure1_bounded", "figure1"), ("loops",)),
    ("radius", "Error and radius", ("certificate",), ()),
    ("errors", "Where networks err", ("errors", "kinds", "box"), ("accuracy", "kinds")),
    ("delays", "Delays and first estimates", ("delays",), ()),
    ("scenarios", "Other conditions", ("scenarios",), ("scenarios",)),
    ("certified", "With a confidence", ("certified",), ("certified",)),
    ("training", "Training", ("learning",), ("training",)),
    ("speed", "Speed", ("speed",), ("bench", "speed")),
    ("coverage", "Coverage of the data", ("coverage",), ("coverage",)),
)  # identifier, heading, figures, tables


class PipelineResults:
    """The results of the stages of one pipeline that there are, read from their folders; generate has to be there."""

    def __init__(self, config: Pipeline, plant: Plant, folders: dict[str, Path]) -> None:
        self.config, self.plant = config, plant
        self.keys = {name: folder.name for name, folder in folders.items()}
        self.generated = Generated.read(folders["generate"])
        self.trained = {name: Trained.read(folders[name]) for name in config.train.models if name in folders}
        self.benched = Benched.read(folders["bench"]) if "bench" in folders else None
        self.evaluated: Evaluated | None = None
        self.evaluation: EvaluationData | None = None
        if "evaluate" in folders:
            self.evaluated = Evaluated.read(folders["evaluate"])
            self.evaluation = EvaluationData.read(folders["evaluate"], plant, config.evaluate, self.evaluated)
        lines = {name: json_files.read(folders[name] / "metrics.jsonl").splitlines() for name in self.trained}
        self.histories = {name: [*map(json_files.parse, each)] for name, each in lines.items()}
        self.certified: Certified | None = None
        self.rollout_errors: dict[PredictorId, np.ndarray] = {}  # the largest error of each rollout (N,), by network
        if "certify" in folders:
            self.certified = Certified.read(folders["certify"])
            with h5py.File(folders["certify"] / "errors.h5", "r") as opened:
                file: Any = opened
                self.rollout_errors = {PredictorId.parse(str(name)): np.asarray(file[name]) for name in file}

    def figures(self) -> dict[str, Figure]:
        """Every figure by name, in order."""
        histories = dict(zip(ranked(map(PredictorId, self.histories)), self.histories.values(), strict=True))
        every: list[Figure | None] = []
        if self.evaluation:
            every += [figures.figure1_bounded(self.evaluation), figures.figure1(self.evaluation)]
        evaluation = self.evaluation if self.evaluated else None
        if evaluation and self.evaluated:
            of_loops = (figures.certificate, figures.errors, figures.kinds, figures.box, figures.delays)
            every += [draw(evaluation) for draw in of_loops]
            every.append(figures.scenarios(self.plant, self.evaluated.scenarios))
        every += [
            figures.certified(self.plant, self.certified, self.rollout_errors),
            figures.learning(histories) if histories else None,
            figures.speed(self.benched.rows) if self.benched else None,
            figures.coverage(evaluation) if evaluation else None,
        ]
        return {figure.name: figure for figure in every if figure}

    def tables(self) -> dict[str, Table]:
        """Every table by name, in order."""
        every: list[Table | None] = []
        if self.evaluated:
            every += [make(self.evaluated) for make in (tables.accuracy, tables.kinds, tables.loops)]
            every.append(tables.scenarios(self.plant, self.evaluated))
        every += [self.certified and tables.certified(self.certified), tables.training(self.trained)]
        if self.benched:
            every += [tables.speed(self.benched.rows), tables.by_dx(self.benched.rows)]
        if self.evaluated:
            every.append(tables.outside(self.plant, self.evaluated.coverage))
        return {table.name: table for table in every if table}


def run(job: Job) -> Reported:
    """Write report.html from the results of the other stages; the same bytes for the same results.

    Inline SVG, style and script; nothing is loaded. Its three sentences are in the result, and
    before them a caution where no network is good. While a run goes on, it is written of the results that there are,
    and of the loop with the numerical predictor, and says what follows.
    """
    results = PipelineResults(job.config, job.plant, job.inputs)
    job.progress.doing("report", "drawing")
    text, caution = sentences(job.plant, results.evaluated, results.benched), ""
    if results.evaluated:
        caution = results.evaluated.caution
    else:
        results.evaluation = evaluate.begun(job)
    if follow := [name for name in nodes(job.config, ["report"])[-1].inputs if name not in job.inputs]:
        caution = f"{UNFINISHED} When it was written, the run went on with: {', '.join(follow)}."
    drawn, tabulated = results.figures(), results.tables()
    chapters = [
        {
            "id": name,
            "title": title,
            "figures": [drawn[each] for each in shown if each in drawn],
            "notes": bench.sentences(results.benched) if results.benched and name == "speed" else [],
            "tables": [tabulated[each] for each in below if each in tabulated],
        }
        for name, title, shown, below in CHAPTERS
        if drawn.keys() & {*shown}
    ]
    config, plant = job.config, job.plant
    parameters = {name: f"{value:g}" for name, value in plant.parameters.items()}
    data = {"samples": results.generated.samples, "rollouts": results.generated.rollouts}
    facts = {
        "Question": {"pipeline": config.name, "seed": config.seed, "plant": plant.name} | parameters | data,
        "Results": results.keys,
    }
    if results.benched:
        hardware = results.benched.hardware
        facts["Machine"] = hardware.model_dump(exclude={"versions"}, exclude_unset=True) | hardware.versions
    page = html_page.filled(
        html_page.text("page.html"),
        name=config.name,
        about="; ".join(_about(plant, config.evaluate)),
        said=text,
        caution=caution,
        chapters=chapters,
        folded=FOLDED,
        facts=facts,
        files=config.files,
        settings=dumps(config.with_file_names().model_dump()),
    )
    (job.folder / NAME).write_text(page, encoding="utf-8")
    return Reported(summary=[caution, *text] if caution else text, bytes=len(page.encode()))


def summary(result: Reported, width: int | None = None) -> str:
    return "\n".join(result.summary)


def _about(plant: Plant, config: Evaluate) -> Iterator[str]:
    """The plant, its delay, and the parts of the loop that are not as in the paper."""
    states, inputs = (", ".join(symbol(plant, name) for name in names) for names in (plant.states, plant.inputs))
    yield f"{plant.name}: states {states}"
    yield f"inputs {inputs}"
    if plant.declares_delay:
        yield "a delay that the plant declares"
    else:
        estimate = "its estimate constant" if config.adaptation == FROZEN else "unknown to the controller"
        yield f"delay D = {plant.time_text(config.D)}, {estimate}"
    if config.actuator == "history":
        yield "actuator state not measured"
    if config.timing:
        yield "the controller called at irregular times"
    if config.observer:
        yield f"the state estimated by {config.observer.kind}"
    if config.safety:
        yield "limits kept by a safety filter"
    sensors = []
    for key, value in vars(config.measurement).items():
        if np.any(value):  # noise, jitter and drop are shares
            unit = (
                plant.time_unit
                if key in ("period", "delay")
                else "%"
                if key in ("relative_noise", "jitter", "drop")
                else ""
            )
            numbers = [f"{100 * number if unit == '%' else number:g}" for number in np.atleast_1d(value)]
            sensors.append(f"{key} {' / '.join(numbers)}\N{NO-BREAK SPACE}{unit}".rstrip())
    if sensors:
        yield f"measurements with {', '.join(sensors)}"
    if config.truth or config.truth_scale != 1 or config.disturbance.amplitude:
        yield "the simulated plant is not the controller's model"


def sentences(plant: Plant, evaluated: Evaluated | None, benched: Benched | None) -> list[str]:
    """A run in up to three sentences with their numbers: the error, the closed loop, the time of a call."""
    said = []
    if evaluated:
        networks = [each for each in evaluated.models if each.is_network and each.epoch is None]
        said += [_errors(evaluated, networks), _loops(plant, evaluated, networks)]
    return [*said, _speed(benched)] if benched else said


def _errors(evaluated: Evaluated, networks: list[PredictorId]) -> str:
    rows = [evaluated.models[network] for network in networks]
    largest = [
        f"{short(row.eps_sup)} for the {network.label} (mean square {short(row.mse)})"
        for network, row in zip(networks, rows, strict=True)
    ]
    first, *others = evaluated.kinds
    samples = f"{evaluated.held_out:,} held-out samples of {OF[first]}"
    parts = [f"On {samples} the largest error of a prediction is {_and(largest)}"]
    for kind in others:
        errors = [short(row.kinds[kind].eps_sup) for row in rows]
        parts.append(f"on {evaluated.kinds[kind].rows:,} of {OF[kind]} it is {_and(errors)}")
    return "; ".join(parts) + "."


def _loops(plant: Plant, evaluated: Evaluated, networks: list[PredictorId]) -> str:
    radii = {predictor: scores.radius for predictor, scores in evaluated.models.items()}
    counts = [f"numerical predictor {radii[NUMERICAL].count}"]
    counts += [f"{n.label} {radii[n].count} (median radius {short(radii[n].median)})" for n in networks]
    delay = "constant delay estimate"
    if NO_ADAPTATION in radii:
        counts.append(f"without adaptation {radii[NO_ADAPTATION].count}")
        delay = "delay unknown to the controller"
    if plant.declares_delay:
        delay = "delay declared by the plant"
    near = f"{100 * metrics.SETTLED:g} % of the reference"
    if plant.rests:
        near = f"{short(metrics.SETTLED * metrics.size(plant.equilibrium))} of rest"
    return f"{radii[NUMERICAL].cases} closed loops, {delay}. End within {near}: {', '.join(counts)}."


def _speed(benched: Benched) -> str:
    """The fastest call of a network on the finest grid, beside what is like it, and the fastest method as accurate."""
    finest = min((row.dx for row in benched.table), default=0.0)
    networks = [row for row in benched.table if row.is_network and row.dx == finest]
    if not networks:
        return "No network was timed."
    row = min(networks, key=lambda row: row.median_us)
    text = f"A call of the {label(row)}, takes {row.median_us:.1f} µs at dx = {finest:.3g}"
    if row.speedup_published is not None:  # inputs with several delays have no published predictor
        text += f", {row.speedup_published:,.0f} times as fast as interpreted O(nx²) sums"
        for same in networks:  # torch against the sums is what Table I compares
            if same.predictor == row.predictor and same.runtime == "torch" != row.runtime and not same.copies:
                text += f" (by torch {same.speedup_published:,.0f} times)"
        if row.speedup_compiled is not None:
            text += f" and {row.speedup_compiled:.2g} times as fast as compiled Euler"
    for crossover in [each for each in benched.crossover if each.predictor == row.predictor][:1]:
        method = bench.method_on(crossover.best, crossover.best_steps)
        text += (
            f"; {method} is as accurate in {crossover.best_us:.1f} µs as the network"
            f" at dx = {crossover.dx:.3g} in {crossover.network_us:.1f} µs"
        )
    return f"{text}."


def _and(texts: list[str]) -> str:
    """a, b and c."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if texts[1:] else texts)
