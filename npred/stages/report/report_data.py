"""All results of a pipeline as one story: its figures and its tables, for the page and for papers."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from npred import figures, json_files
from npred.config import Pipeline
from npred.defaults import RESULT
from npred.figures import Evidence, Plate
from npred.figures.table import Grid
from npred.plants import Plant
from npred.stages.report import tables


@dataclass(frozen=True)
class Story:
    """What the stages of one pipeline found; `keys` names their results."""

    config: Pipeline
    plant: Plant
    evaluated: dict[str, Any]
    benched: dict[str, Any]
    trained: dict[str, dict[str, Any]]
    histories: dict[str, list[dict[str, float]]]
    generated: dict[str, Any]
    evidence: Evidence
    keys: dict[str, str]

    @classmethod
    def read(cls, config: Pipeline, plant: Plant, inputs: dict[str, Path]) -> "Story":
        """The story of the results in these folders: generate, each network, evaluate, bench."""
        results = {name: json_files.table(folder / RESULT) for name, folder in inputs.items()}
        networks = config.train.models
        histories = {name: _lines(inputs[name] / "metrics.jsonl") for name in networks}
        evidence = Evidence.read(inputs["evaluate"], plant, config.evaluate, results["evaluate"])
        trained = {name: results[name] for name in networks}
        keys = {name: folder.name for name, folder in inputs.items()}
        answers = results["evaluate"], results["bench"], trained, histories, results["generate"]
        return cls(config, plant, *answers, evidence, keys)

    def plates(self) -> dict[str, Plate]:
        """Every figure by name, in order."""
        kinds = figures.figure1, figures.certificate, figures.errors, figures.kinds, figures.box, figures.delays
        plates = [kind(self.evidence) for kind in kinds]
        plates += [
            figures.learning(self.histories),
            figures.speed(self.benched["rows"]),
            figures.coverage(self.evidence),
        ]
        return {plate.name: plate for plate in plates if plate}

    def tables(self) -> dict[str, Grid]:
        """Every table by name, in order."""
        made = [
            tables.accuracy(self.evaluated["models"], self.evaluated["held_out_kind"]),
            tables.kinds(self.evaluated),
            tables.loops(self.evaluated["models"]),
            tables.training(self.trained),
            tables.speed(self.benched["rows"]),
            tables.by_dx(self.benched["rows"]),
            tables.outside(self.plant, self.evaluated["coverage"]),
        ]
        return {table.name: table for table in made}


def _lines(path: Path) -> list[dict[str, float]]:
    return [json_files.parse(line) for line in json_files.read(path).splitlines()]
