"""The log in a recording: the columns of a plant's inputs and outputs, in the plant's units."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from npred import recordings
from npred.errors import ConfigError, unlisted
from npred.identification.log import Log
from npred.plants import Plant


def read(
    plant: Plant, path: Path, columns: Mapping[str, str], scale: Mapping[str, float], shift: Mapping[str, float],
    time: str | None = None, time_unit: str | None = None,
) -> Log:  # fmt: skip
    """The log; a column c is scale[c] c + shift[c] in the plant's unit.

    Raises ConfigError where an input has no column, or no output has one.
    """
    every = {name: columns.get(name, name) for name in (*plant.inputs, *plant.outputs)}
    for name in columns:
        if name not in every:
            raise ConfigError(unlisted("columns", name, every, f"inputs or outputs of plant {plant.name},"))
    chosen = _measured(plant, path, every, columns)
    for key in (*scale, *shift):
        if key not in chosen.values():
            raise ConfigError(unlisted("scale, shift", key, chosen.values(), "columns that are read,"))
    series = recordings.read(path, list(chosen.values()), time, time_unit)
    there = {
        name: (series[c].t, scale.get(c, 1.0) * series[c].values + shift.get(c, 0.0)) for name, c in chosen.items()
    }
    return Log.of_series(_some(there, plant.inputs), _some(there, plant.outputs))


def _measured(plant: Plant, path: Path, every: Mapping[str, str], columns: Mapping[str, str]) -> dict[str, str]:
    """The columns to read: all but outputs that the recording does not have, and that `columns` does not name."""
    there = recordings.columns(path)
    unmeasured = [name for name in plant.outputs if every[name] not in there and name not in columns]
    if len(unmeasured) == len(plant.outputs):
        raise ConfigError(
            f"{path}: expected a column for one of {', '.join(plant.outputs)}, found {', '.join(there)}; map one by "
            f"columns or --state, as {plant.outputs[0]}={there[-1] if there else 'y'}"
        )
    return {name: column for name, column in every.items() if name not in unmeasured}


def _some(series: Mapping[str, tuple[np.ndarray, np.ndarray]], names: Sequence[str]) -> list:
    return [series.get(name) for name in names]
