"""The parts of a node's key: slices of the configuration, and digests of the plant's functions.

Methods, laws and observers of files enter by what the files hold, not by where they are.
"""

import hashlib
import json
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from npred.base import registry
from npred.base.errors import ConfigError
from npred.base.json_files import mapped, regular, sha256
from npred.lab.config import LoopTable, Pipeline, Section
from npred.plants import Plant


@lru_cache(maxsize=64)
def identity(plant: Plant) -> dict[str, Any]:
    """All of a plant that a result depends on: names, parameters, and the digest of each function.

    A remark in the file that declares the plant changes no formula, and so no key.
    """
    parts = {
        "name": plant.name,
        "states": list(plant.states),
        "inputs": list(plant.inputs),
        "parameters": plant.parameters,
        "box": {name: list(span) for name, span in plant.box.items()},
        "input_bounds": plant.input_bounds and [list(pair) for pair in plant.input_bounds],
        "state_bounds": {name: list(pair) for name, pair in plant.state_bounds.items()},
        "guess": plant.guess.tolist(),
        "ratios": plant.ratios.tolist(),
        "period": plant.period,
        "program": {name: _digest(text) for name, text in plant.program.items()},
    }
    return mapped(parts, _word)


def table(section: Section) -> dict[str, Any]:
    """A table as JSON."""
    return mapped(section.model_dump(mode="json"), _word)


def content(key: str, path: Path) -> str:
    """The digest of the content of a file, or of all files of a folder, that a key of the pipeline names."""
    try:
        if path.is_dir():
            every = {str(file.relative_to(path)): sha256(file) for file in sorted(path.rglob("*")) if file.is_file()}
            return hashlib.sha256(json.dumps(every).encode()).hexdigest()
        return sha256(regular(path))
    except OSError as error:
        raise ConfigError(f"{key}: expected a file at {path}, got: {error.strerror}; check the path") from None


@dataclass(frozen=True)
class Slices:
    """The parts that the key of a node may hold beside the plant's identity and the seed; `model` names its network."""

    config: Pipeline
    plant: Plant
    model: str | None
    device: str

    def loop(self, stage: str) -> dict[str, Any]:
        """The table of a stage that runs loops, and the digests of the plant's functions that only such loops use."""
        settings: LoopTable = getattr(self.config, stage)
        section = table(settings)
        section["predictor"] = registry.METHODS.identity(settings.predictor)
        scenarios = section.get("scenarios", [])
        for holder in [section, *scenarios]:
            if holder["integrator"]:
                holder["integrator"] = registry.METHODS.identity(holder["integrator"])
            if holder["adaptation"]:
                holder["adaptation"] = registry.DELAY_LAWS.identity(holder["adaptation"])
            if observer := holder["observer"]:
                observer["kind"] = registry.OBSERVERS.identity(observer["kind"])
                section |= self.output
        if settings.predictor == "semi_implicit" or stage == "evaluate":  # where a guard may choose that method
            section |= self.mechanics
        if (settings.safety or stage == "evaluate") and self.plant.declares_safe:  # it tells how limits are kept anyway
            section["safe"] = _digest(self.plant.printed("safe"))
        return section

    @property
    def mechanics(self) -> dict[str, str]:
        """The digest of the plant's mechanics, where it declares them."""
        return {"mechanics": _digest(self.plant.printed("mechanics"))} if self.plant.declares_mechanics else {}

    @property
    def output(self) -> dict[str, str]:
        """The digest of the outputs, where they are not the state."""
        return {"output": _digest(self.plant.printed("output"))} if self.plant.declares_output else {}

    @property
    def networks(self) -> dict[str, Any]:
        return {"train": {"models": self.config.train.models}}

    @property
    def box(self) -> dict[str, Any]:
        """The ranges that the plant leaves to the pipeline; data that are simulated in them differ where they do."""
        generate = self.config.generate
        ranges = {name: ends for name, ends in table(generate)["box"].items() if name not in self.plant.box}
        return {"box": ranges} if generate.data and ranges else {}

    @property
    def notation(self) -> dict[str, Any]:
        """The labels and units of figures: other labels draw them again, and train nothing."""
        plant = self.plant
        parts = {"labels": plant.labels, "units": plant.units, "time_unit": plant.time_unit, "figure": plant.figure}
        return {"notation": parts}


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _word(leaf: Any) -> Any:
    """JSON has no infinity, and an input bounded on one side only has one: as text it can enter a key."""
    return str(leaf) if isinstance(leaf, float) and not math.isfinite(leaf) else leaf
