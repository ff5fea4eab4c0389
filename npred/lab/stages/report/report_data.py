"""All results of a pipeline: figures and tables, for the page and for papers, and three sentences."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred.base import json_files
from npred.lab.config import Pipeline
from npred.lab.config.results import (  # fmt: skip
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
from npred.lab.report import figures
from npred.lab.report.figures import EvaluationData, Figure
from npred.lab.report.figures.evaluation_data import OF
from npred.lab.report.figures.latency import label
from npred.lab.report.figures.style import short
from npred.lab.report.figures.table import Table
from npred.lab.stages.bench import bench, break_even
from npred.lab.stages.report import tables
from npred.loop import metrics
from npred.plants import Plant

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
    evaluation: EvaluationData
    keys: dict[str, str]
    certified: Certified | None = None
    rollout_errors: dict[PredictorId, np.ndarray] = field(default_factory=dict)  # the largest of each rollout (N,)

    @classmethod
    def read(cls, config: Pipeline, plant: Plant, inputs: dict[str, Path]) -> "PipelineResults":
        """The results in these folders: all but certify have to be there."""
        evaluated = Evaluated.read(inputs["evaluate"])
        lines = {name: json_files.read(inputs[name] / "metrics.jsonl").splitlines() for name in config.train.models}
        certificate: dict[str, Any] = {}
        if "certify" in inputs:
            certificate["certified"] = Certified.read(inputs["certify"])
            with h5py.File(inputs["certify"] / "errors.h5", "r") as opened:
                file: Any = opened
                certificate["rollout_errors"] = {PredictorId.parse(str(name)): np.asarray(file[name]) for name in file}
        return cls(
            config,
            plant,
            evaluated,
            benched=Benched.read(inputs["bench"]),
            trained={name: Trained.read(inputs[name]) for name in lines},
            histories={name: [*map(json_files.parse, each)] for name, each in lines.items()},
            generated=Generated.read(inputs["generate"]),
            evaluation=EvaluationData.read(inputs["evaluate"], plant, config.evaluate, evaluated),
            keys={name: folder.name for name, folder in inputs.items()},
            **certificate,
        )

    def figures(self) -> dict[str, Figure]:
        """Every figure by name, in order."""
        histories = dict(zip(ranked(map(PredictorId, self.histories)), self.histories.values(), strict=True))
        every = [
            figures.figure1_bounded(self.evaluation),
            figures.figure1(self.evaluation),
            figures.certificate(self.evaluation),
            figures.errors(self.evaluation),
            figures.kinds(self.evaluation),
            figures.box(self.evaluation),
            figures.delays(self.evaluation),
            figures.scenarios(self.plant, self.evaluated.scenarios),
            figures.certified(self.plant, self.certified, self.rollout_errors),
            figures.learning(histories),
            figures.speed(self.benched.rows),
            figures.coverage(self.evaluation),
        ]
        return {figure.name: figure for figure in every if figure}

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


def sentences(plant: Plant, evaluated: Evaluated, benched: Benched) -> list[str]:
    """A run in three sentences with their numbers: the error, the closed loop, the time of a call."""
    networks = [each for each in evaluated.models if each.is_network and each.epoch is None]
    return [_errors(evaluated, networks), _loops(plant, evaluated, networks), _speed(benched)]


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
    counts = [f"{radii[n].count} with the {n.label} (median radius {short(radii[n].median)})" for n in networks]
    counts.append(f"{radii[NUMERICAL].count} with the numerical predictor")
    delay = "with the delay estimate held"
    if NO_ADAPTATION in radii:
        counts.append(f"{radii[NO_ADAPTATION].count} without adaptation")
        delay = "with a delay that the controller does not know"
    if plant.declares_delay:
        delay = "with a delay that the plant declares"
    near = f"{100 * metrics.SETTLED:g} % of the reference"
    if plant.rests:
        near = f"{short(metrics.SETTLED * metrics.size(plant.equilibrium))} of rest"
    return f"Of {radii[NUMERICAL].cases} closed loops {delay}, {_and(counts)} end within {near}."


def _speed(benched: Benched) -> str:
    """The fastest call of a network on the finest grid, and the fastest method that is as accurate."""
    finest = min((row.dx for row in benched.table), default=0.0)
    networks = [row for row in benched.table if row.is_network and row.dx == finest]
    if not networks:
        return "No network was timed."
    row = min(networks, key=lambda row: row.median_us)
    text = f"A call of the {label(row)}, takes {row.median_us:.1f} µs at dx = {finest:.3g}"
    if row.speedup_published is not None:  # inputs with several delays have no published predictor
        text += f", {row.speedup_published:,.0f} times faster than interpreted O(nx²) sums"
    for crossover in [each for each in benched.crossover if each.predictor == row.predictor][:1]:
        dx = bench.timed_dx(benched, crossover)
        method = break_even.method_on(crossover.best, crossover.best_steps)
        text += (
            f"; {method} is as accurate in {crossover.best_us:.1f} µs as the network"
            f"{'' if dx is None else f' at dx = {dx:.3g}'} in {crossover.network_us:.1f} µs"
        )
    return f"{text}."


def _and(texts: list[str]) -> str:
    """a, b and c."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if texts[1:] else texts)
