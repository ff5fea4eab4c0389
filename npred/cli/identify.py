"""`npred identify`: the delay of a plant by a recording, a page of it, and a pipeline with that delay."""

import re
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from npred.base.errors import ConfigError
from npred.cli.execute import bring
from npred.cli.options import Work, argument, flag, rewritable
from npred.lab import config
from npred.lab.config import Pipeline
from npred.lab.config.results import IdentifiedResult
from npred.lab.stages.identify.identify import PAGE
from npred.lab.stages.report import toml_text
from npred.plants import Plant


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
    def config(self) -> Pipeline:
        """The pipeline of a recording: a plant, and the table [identify]."""
        table: dict[str, Any] = {}
        if self.pipeline.suffix == ".toml":
            table = config.table(self.pipeline)
        elif self.plant:
            table = {"name": re.sub(r"[^\w.-]+", "_", self.pipeline.stem).strip("._-") or "log"}
            table |= {"identify": {"data": str(self.pipeline)}}
        else:
            raise ConfigError(f"--plant: expected the plant of {self.pipeline}, got none; add --plant my_plant.py:Tank")
        table |= {"plant": self.plant} if self.plant else {}
        columns = _pairs(self.input, "--input NAME=COLUMN") | _pairs(self.state, "--state NAME=COLUMN")
        ranges = _pairs(self.bounds, "--bounds NAME=LOW:HIGH")
        named = {
            "time": self.time, "time_unit": self.time_unit, "longest": self.longest, "model_error": self.model_error,
            "free": self.free, "offset": self.offset or None, "time_varying": self.time_varying or None,
            "columns": columns,
            "scale": {key: _number(text) for key, text in _pairs(self.scale, "--scale COLUMN=FACTOR").items()},
            "shift": {key: _number(text) for key, text in _pairs(self.shift, "--shift COLUMN=NUMBER").items()},
            "bounds": {key: [_number(end) for end in text.split(":")] for key, text in ranges.items()},
        }  # fmt: skip
        table.setdefault("identify", {}).update({key: value for key, value in named.items() if value})
        for override in self.set or []:
            config.override(table, override)
        return config.parse(table, str(self.pipeline))


def _pairs(texts: list[str] | None, form: str) -> dict[str, str]:
    pairs = [text.partition("=") for text in texts or []]
    for key, sign, value in pairs:
        if not (key and sign and value):
            raise ConfigError(f"expected {form}, got {key + sign + value!r}; write both with = between them")
    return {key: value for key, _, value in pairs}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"expected a number, got {text!r}; write one, as 0.01") from None


def identify(
    options: Recorded,
    *,
    output: Annotated[
        Path | None, flag("The pipeline that is written; LOG's name with .toml, here, by default.", "-o", "--output")
    ] = None,
) -> None:
    """The answer of the stage; the page and the pipeline are written beside each other."""
    artifact = bring(options, ["identify"])[-1].artifact
    result, plant = IdentifiedResult.read(artifact.folder), options.planner().plant
    path = output or Path(f"{options.config.name}.toml")
    page = path.with_suffix(".html")
    try:
        shutil.copyfile(artifact.folder / PAGE, page)
    except OSError as error:
        todo = "name another by -o"
        raise ConfigError(f"{page}: expected a file that can be written, got: {error.strerror}; {todo}") from None
    files = [page] + ([_pipeline(options, plant, result, path)] if all(result.identifiable) else [])
    said = "\n".join([*result.sentences, *(f"wrote {file}" for file in files)])
    if not all(result.identifiable):
        said += "\nno pipeline was written: the recording does not tell the delay"
    options.show(result.json_object() | {"files": list(map(str, files))}, lambda: said)


def _pipeline(options: Recorded, plant: Plant, result: IdentifiedResult, path: Path) -> Path:
    """The pipeline file with the longest delay and its interval, and the parameters. Another's file is left alone."""
    target = rewritable(path, "identify")
    longest = max(range(plant.m), key=lambda j: result.D[j])
    D, (low, high) = result.D[longest], result.interval[longest]
    loop = {"D": float(f"{D:.6g}"), "bounds": [float(f"{end:.6g}") for end in (low, high)]}
    middle = [
        sum(plant.box[state]) / 2 if state in plant.box else float(x)
        for state, x in zip(plant.states, plant.guess, strict=True)
    ]
    loop |= {} if plant.declares_V else {"adaptation": "delay-observer", "actuator": "history"}
    tables = {
        "name": options.config.name, "plant": options.config.plant,
        **({"kappa": options.config.kappa} if options.config.kappa else {}),
        "parameters": options.config.parameters | {k: v for k, v in result.parameters.items() if k in plant.parameters},
        "generate": loop, "evaluate": loop | {"X0": middle},
    }  # fmt: skip
    head = f"{target} {options.pipeline.name}\n" + "".join(f"# {sentence}\n" for sentence in result.sentences)
    if plant.m > 1 and plant.one_delay:
        delays = ", ".join(f"{delay:.6g}" for delay in result.D)
        head += f"# The inputs have different delays: write delays = ({delays}) in the plant's class.\n"
    path.write_text(f"{head}\n{toml_text.dumps(tables)}", encoding="utf-8")
    return path
