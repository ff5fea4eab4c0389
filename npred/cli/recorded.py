"""The flags of `npred identify`, and the pipeline that they make of a recording."""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from npred.cli.options import Work, argument, flag
from npred.errors import ConfigError

if TYPE_CHECKING:  # pydantic comes with it, which `npred --help` has no use for
    from npred.config import Pipeline


@dataclass(frozen=True)
class Recorded(Work):
    """Flags of the command that reads a recording; each has its place in the table [identify]."""

    pipeline_name: Annotated[
        str | None, argument("LOG", "A recording, as log.csv; or a pipeline that names one.", default=False)
    ] = None
    plant: Annotated[str | None, flag("The plant: a name, or my_plant.py:Tank.", word="PLANT")] = None
    time: Annotated[str | None, flag("The column of the times.", word="COLUMN")] = None
    time_unit: Annotated[str | None, flag("Unit of the time column.", word="s|ms|us|ns|min|h")] = None
    input: Annotated[
        list[str] | None, flag("An input and its column, as q=Q1; repeatable.", "--input", word="NAME=COLUMN")
    ] = None
    state: Annotated[
        list[str] | None,
        flag("A state or output and its column, as h=T1.", "--state", "--output-column", word="NAME=COLUMN"),
    ] = None
    scale: Annotated[list[str] | None, flag("A factor to the plant's unit, as T1=0.01.", word="COLUMN=FACTOR")] = None
    shift: Annotated[list[str] | None, flag("Offset added after scaling, as T1=273.15.", word="COLUMN=NUMBER")] = None
    free: Annotated[list[str] | None, flag("A parameter to estimate; repeatable.", word="NAME")] = None
    bounds: Annotated[list[str] | None, flag("The range of one, as gain=0.1:2.", word="NAME=LOW:HIGH")] = None
    longest: Annotated[float | None, flag("The longest delay to try; by default a fifth of the log.")] = None
    offset: Annotated[bool, flag("Estimate a constant that is added to each input.", "--offset")] = False
    time_varying: Annotated[bool, flag("Estimate the delays over windows of time, too.", "--time-varying")] = False
    model_error: Annotated[float | None, flag("How far other parameters may be off, relatively; 0.05 by default.")] = (
        None
    )

    @cached_property
    def pipeline(self) -> Path:
        """The recording, or the pipeline that names it."""
        if self.pipeline_name is None:
            raise ConfigError(
                "identify: expected a recording, got none; write npred identify log.csv --plant my_plant.py:Tank"
            )
        return Path(self.pipeline_name)

    @cached_property
    def config(self) -> "Pipeline":
        """The pipeline of a recording: a plant, and the table [identify]."""
        from npred import config

        table: dict[str, Any] = {}
        if self.pipeline.suffix == ".toml":
            table = config.table(self.pipeline)
        elif self.plant:
            table = {"name": re.sub(r"[^\w.-]+", "_", self.pipeline.stem).strip("._-") or "log"}
            table |= {"identify": {"data": str(self.pipeline)}}
        else:
            raise ConfigError(f"--plant: expected the plant of {self.pipeline}, got none; add --plant my_plant.py:Tank")
        table |= {"plant": self.plant} if self.plant else {}
        table.setdefault("identify", {}).update(self._identify())
        for override in self.set or []:
            config.override(table, override)
        return config.parse(table, str(self.pipeline))

    def _identify(self) -> dict[str, object]:
        """What the flags say of the table."""
        named = {
            "time": self.time, "time_unit": self.time_unit, "longest": self.longest, "model_error": self.model_error,
            "free": self.free, "offset": self.offset or None, "time_varying": self.time_varying or None,
            "columns": dict(
                _pair(text, f"{name} NAME=COLUMN")
                for name, texts in (("--input", self.input), ("--state", self.state))
                for text in texts or []
            ),
            "scale": _numbers(self.scale, "--scale COLUMN=FACTOR"),
            "shift": _numbers(self.shift, "--shift COLUMN=NUMBER"),
            "bounds": {
                key: [_number(end) for end in value.split(":")]
                for key, value in (_pair(text, "--bounds NAME=LOW:HIGH") for text in self.bounds or [])
            },
        }  # fmt: skip
        return {key: value for key, value in named.items() if value}


def _pair(text: str, form: str) -> tuple[str, str]:
    key, sign, value = text.partition("=")
    if not (key and sign and value):
        raise ConfigError(f"expected {form}, got {text!r}; write both with = between them")
    return key, value


def _numbers(texts: list[str] | None, form: str) -> dict[str, float]:
    return {key: _number(value) for key, value in (_pair(text, form) for text in texts or [])}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"expected a number, got {text!r}; write one, as 0.01") from None
