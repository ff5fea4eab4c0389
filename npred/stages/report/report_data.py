"""All results of a pipeline as one story: figures and tables, for the page and for papers, and three sentences."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred import figures, json_files
from npred.config import Pipeline
from npred.figures import EvaluationData, Figure
from npred.figures.evaluation_data import OF
from npred.figures.latency import label
from npred.figures.style import short
from npred.figures.table import Table
from npred.loop import metrics
from npred.plants import Plant
from npred.results import (
    NO_ADAPTATION,
    NUMERICAL,
    Benched,
    Certified,
    Evaluated,
    Generated,
    PredictorId,
    Trained,
    ranked,
)
from npred.results.evaluate import Scores
from npred.stages.bench import timing_tables
from npred.stages.bench.sentences import method_on
from npred.stages.report import tables

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


@dataclass(frozen=True)
class PipelineResults:
    """The results of the stages of one pipeline; `keys` names them."""

    config: Pipeline
    plant: Plant
    evaluated: Evaluated
    benched: Benched
    trained: dict[str, Trained]
    histories: dict[str, list[dict[str, float]]]
    generated: Generated
    evidence: EvaluationData
    keys: dict[str, str]
    certified: Certified | None = None
    rollout_errors: dict[PredictorId, np.ndarray] = field(default_factory=dict)

    @classmethod
    def read(cls, config: Pipeline, plant: Plant, inputs: dict[str, Path]) -> "PipelineResults":
        """The story of the results in these folders: all but certify have to be there."""
        evaluated, benched = Evaluated.read(inputs["evaluate"]), Benched.read(inputs["bench"])
        trained = {name: Trained.read(inputs[name]) for name in config.train.models}
        lines = {name: json_files.read(inputs[name] / "metrics.jsonl").splitlines() for name in trained}
        histories = {name: [*map(json_files.parse, each)] for name, each in lines.items()}
        evidence = EvaluationData.read(inputs["evaluate"], plant, config.evaluate, evaluated)
        keys = {name: folder.name for name, folder in inputs.items()}
        generated = Generated.read(inputs["generate"])
        certificate: dict[str, Any] = {}
        if "certify" in inputs:
            certificate["certified"] = Certified.read(inputs["certify"])
            certificate["rollout_errors"] = _rollout_errors(inputs["certify"] / "errors.h5")
        return cls(config, plant, evaluated, benched, trained, histories, generated, evidence, keys, **certificate)

    def plates(self) -> dict[str, Figure]:
        """Every figure by name, in order."""
        kinds = figures.figure1_bounded, figures.figure1, figures.certificate, figures.errors, figures.kinds
        kinds = *kinds, figures.box, figures.delays
        plates = [*(kind(self.evidence) for kind in kinds), figures.scenarios(self.plant, self.evaluated.scenarios)]
        plates += [
            figures.certified(self.plant, self.certified, self.rollout_errors),
            figures.learning(dict(zip(ranked(map(PredictorId, self.histories)), self.histories.values(), strict=True))),
            figures.speed(self.benched.rows),
            figures.coverage(self.evidence),
        ]
        return {plate.name: plate for plate in plates if plate}

    def tables(self) -> dict[str, Table]:
        """Every table by name, in order."""
        every = [
            tables.accuracy(self.evaluated),
            tables.kinds(self.evaluated),
            tables.loops(self.evaluated),
            tables.scenarios(self.plant, self.evaluated),
            tables.certified(self.certified),
            tables.training(self.trained),
            tables.speed(self.benched.rows),
            tables.by_dx(self.benched.rows),
            tables.outside(self.plant, self.evaluated.coverage),
        ]
        return {table.name: table for table in every if table}


def _rollout_errors(path: Path) -> dict[PredictorId, np.ndarray]:
    """The largest error of each rollout (N,), by network."""
    with h5py.File(path, "r") as opened:
        file: Any = opened
        return {PredictorId.parse(str(name)): np.asarray(file[name]) for name in file}


def sentences(plant: Plant, evaluated: Evaluated, benched: Benched) -> list[str]:
    """A run in three sentences with their numbers: the error, the closed loop, the time of a call."""
    networks = [contender for contender in evaluated.models if contender.is_network and contender.epoch is None]
    return [_errors(evaluated, networks), _loops(plant, evaluated, networks), _speed(benched)]


def _errors(evaluated: Evaluated, networks: list[PredictorId]) -> str:
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


def _loops(plant: Plant, evaluated: Evaluated, networks: list[PredictorId]) -> str:
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
    dx = timing_tables.timed_dx(benched, crossover)
    at = "" if dx is None else f" at dx = {dx:.3g}"
    method = method_on(crossover.best, crossover.best_steps)
    return (
        f"; {method} is as accurate in {crossover.best_us:.1f} µs as the network{at} in {crossover.network_us:.1f} µs"
    )
