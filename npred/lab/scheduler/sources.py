"""What a run from Python may begin with: a pipeline or a plant, by name, by file or as an object."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from npred import plants
from npred.base import defaults, registry
from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.config import Pipeline
from npred.plants import Plant

Source = Plant | str | Path | Pipeline


def resolved(source: Source, settings: Mapping[str, Any] = {}) -> Pipeline:
    """The pipeline of a source, with some of its keys changed; see `generate`.

    Raises ConfigError for what there is none of, for an unknown key and for a value out of range.
    """
    if not isinstance(settings, Mapping):
        raise ConfigError(f"settings: expected keys and values, got {settings!r}; write {{'generate.samples': 2000}}")
    chosen = table(source)
    for key, value in settings.items():
        plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        config.put(chosen, key, plain, "settings: ")
    return config.parse(chosen, str(source) if isinstance(source, str | Path) else str(chosen["name"]))


def table(source: Source) -> dict[str, Any]:
    """The pipeline as a plain dictionary; that of a plant has the defaults."""
    if isinstance(source, Plant):
        if source.spec is None:
            raise ConfigError(
                f"plant {source.name}: expected one with a name or a file, by which results are kept, got a class; "
                "write it to a file, and name that: my_plant.py:Tank"
            )
        if source.law and not source.law_table:
            raise ConfigError(
                f"plant {source.name}: expected a kappa by its name, by which results are kept, got a function; "
                "write it to the plant's file"
            )
        law = {"kappa": dict(source.law_table)} if source.law_table else {}
        name = re.sub(r"\W+", "_", source.name)
        return {"name": name, "plant": source.spec, "parameters": dict(source.parameters)} | law
    if not isinstance(source, str | Path | Pipeline):
        raise ConfigError(
            f"source: expected a pipeline or a plant, by name, file or as an object, got {source!r}; name one"
        )
    if isinstance(source, Pipeline):
        return source.model_dump(exclude_unset=True)
    if file(source):
        return config.table(defaults.pipeline(source))
    if not registry.in_file(str(source)) and str(source) not in plants.names():
        raise ConfigError(f"{defaults.missing(Path(source))}, nor a plant of that name; npred plants lists those")
    return table(plants.resolve(str(source)))


def file(source: Source) -> Path | None:
    """The pipeline file that a text names, as the command line takes it; None where it names a plant."""
    if not isinstance(source, str | Path):
        return None
    path = defaults.pipeline(source)
    return path if path.is_file() or path.suffix == ".toml" else None
