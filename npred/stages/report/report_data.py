"""All results of a pipeline as one story: its figures and its tables, for the page and for papers."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from npred import figures, json_files
from npred.config import Pipeline
from npred.figures import Evidence, Plate
from npred.figures.table import Table
from npred.plants import Plant
from npred.results import Benched, Certified, Contender, Evaluated, Generated, Trained, ranked
from npred.stages.report import tables

CHAPTERS = (
    ("loop", "The closed loop", ("figure1",), ("loops",)),
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
class Story:
    """The results of the stages of one pipeline; `keys` names them."""

    config: Pipeline
    plant: Plant
    evaluated: Evaluated
    benched: Benched
    trained: dict[str, Trained]
    histories: dict[str, list[dict[str, float]]]
    generated: Generated
    evidence: Evidence
    keys: dict[str, str]
    certified: Certified | None = None
    rollout_errors: dict[Contender, np.ndarray] = field(default_factory=dict)

    @classmethod
    def read(cls, config: Pipeline, plant: Plant, inputs: dict[str, Path]) -> "Story":
        """The story of the results in these folders: all but certify have to be there."""
        evaluated, benched = Evaluated.read(inputs["evaluate"]), Benched.read(inputs["bench"])
        trained = {name: Trained.read(inputs[name]) for name in config.train.models}
        lines = {name: json_files.read(inputs[name] / "metrics.jsonl").splitlines() for name in trained}
        histories = {name: [*map(json_files.parse, each)] for name, each in lines.items()}
        evidence = Evidence.read(inputs["evaluate"], plant, config.evaluate, evaluated)
        keys = {name: folder.name for name, folder in inputs.items()}
        generated = Generated.read(inputs["generate"])
        certificate: dict[str, Any] = {}
        if "certify" in inputs:
            certificate["certified"] = Certified.read(inputs["certify"])
            certificate["rollout_errors"] = _rollout_errors(inputs["certify"] / "errors.h5")
        return cls(config, plant, evaluated, benched, trained, histories, generated, evidence, keys, **certificate)

    def plates(self) -> dict[str, Plate]:
        """Every figure by name, in order."""
        kinds = figures.figure1, figures.certificate, figures.errors, figures.kinds, figures.box, figures.delays
        plates = [*(kind(self.evidence) for kind in kinds), figures.scenarios(self.plant, self.evaluated.scenarios)]
        plates += [
            figures.certified(self.plant, self.certified, self.rollout_errors),
            figures.learning(dict(zip(ranked(map(Contender, self.histories)), self.histories.values(), strict=True))),
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


def _rollout_errors(path: Path) -> dict[Contender, np.ndarray]:
    """The largest error of each rollout (N,), by network."""
    with h5py.File(path, "r") as opened:
        file: Any = opened
        return {Contender.parse(str(name)): np.asarray(file[name]) for name in file}
