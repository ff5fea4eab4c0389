"""`npred identify`: the delay of a plant by a recording, a page of it, and a pipeline with that delay."""

import re
import shutil
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from npred.base import devices
from npred.base.errors import ConfigError, UnmetError
from npred.base.json_files import plain
from npred.base.progress import announce
from npred.cli.execute import bring
from npred.cli.options import Staged, argument, flag, rewritable
from npred.identification.recordings import USUAL
from npred.lab import config
from npred.lab.config import Pipeline, dumps
from npred.lab.config.results import IdentifiedResult
from npred.lab.report.terminal.console import columns
from npred.lab.scheduler import executors
from npred.lab.stages.identify import pipeline
from npred.lab.stages.identify.identify import PAGE

FOR_JOINTS = {field.name for field in fields(Staged)} - {"set", "force"} | {"time", "time_unit", "period", "longest"}


@dataclass(frozen=True)
class Recorded(Staged):
    """Flags of the command that reads a recording; each has its place in the table [identify]."""

    pipeline_name: Annotated[  # type: ignore[assignment]  here there may be several
        list[str] | None,
        argument("LOG...", "Recordings of one plant, as log.csv; or a pipeline that names them.", default=False),
    ] = None
    plant: Annotated[str | None, flag("The plant: a name, or my_plant.py:Tank.", word="PLANT")] = None
    time: Annotated[str | None, flag("The column with the times.", word="COLUMN")] = None
    time_unit: Annotated[str | None, flag("Unit of the time column.", word="|".join(USUAL))] = None
    period: Annotated[float | None, flag("Time from row to row, in the plant's unit, if the log has no times.")] = None
    hold: Annotated[str | None, flag("Input between two commands: the last one, or a line.", word="zero|linear")] = None
    input: Annotated[list[str] | None, flag("An input and its column, as q=Q1; repeatable.", word="NAME=COLUMN")] = None
    state: Annotated[
        list[str] | None,
        flag("A state or output and its column, as h=T1.", "--state", "--output-column", word="NAME=COLUMN"),
    ] = None
    scale: Annotated[list[str] | None, flag("Factor to the plant's unit, as T1=0.01.", word="COLUMN=FACTOR")] = None
    shift: Annotated[list[str] | None, flag("Offset added after scaling, as T1=273.15.", word="COLUMN=NUMBER")] = None
    free: Annotated[list[str] | None, flag("A parameter to estimate; repeatable.", word="NAME")] = None
    bounds: Annotated[list[str] | None, flag("Range of a parameter, as gain=0.1:2.", word="NAME=LOW:HIGH")] = None
    longest: Annotated[float | None, flag("Longest delay to try; by default a fifth of the log.")] = None
    offset: Annotated[bool, flag("Estimate a constant that is added to each input.", "--offset")] = False
    time_varying: Annotated[bool, flag("Also estimate the delay in windows of time.", "--time-varying")] = False
    model_error: Annotated[float | None, flag("Relative error of the other parameters; by default 0.05.")] = None

    @cached_property
    def pipeline(self) -> Path:
        """The first recording, or the pipeline that names them."""
        return self.logs[0]

    @cached_property
    def logs(self) -> list[Path]:
        """The recordings, or the pipeline that names them."""
        logs = [Path(name) for name in self.pipeline_name or []]
        if not logs:
            todo = "write npred identify log.csv --plant my_plant.py:Tank"
            raise ConfigError(f"identify: expected a recording, got none; {todo}")
        if len(logs) > 1 and any(log.suffix == ".toml" for log in logs):
            got = ", ".join(map(str, logs))
            raise ConfigError(f"identify: expected recordings, or one pipeline, got {got}; name them by data in that")
        return logs

    @property
    def stem(self) -> str:
        """What the files that are written are named after: the first recording, or the pipeline, which stays."""
        name = re.sub(r"[^\w.-]+", "_", self.pipeline.stem).strip("._-") or "log"
        return f"{name}-identified" if self.pipeline.suffix == ".toml" else name

    @cached_property
    def config(self) -> Pipeline:
        """The pipeline of a recording: a plant, and the table [identify]."""
        table: dict[str, Any] = {}
        if self.pipeline.suffix == ".toml":
            table = config.table(self.pipeline)
        elif self.plant:
            table = {"name": self.stem}
            names = [str(log) for log in self.logs]
            table |= {"identify": {"data": names[0] if len(names) == 1 else names}}
        else:
            raise ConfigError(f"--plant: expected the plant of {self.pipeline}, got none; add --plant my_plant.py:Tank")
        table |= {"plant": self.plant} if self.plant else {}
        columns = _pairs(self.input, "--input NAME=COLUMN") | _pairs(self.state, "--state NAME=COLUMN")
        scales, shifts = _pairs(self.scale, "--scale COLUMN=FACTOR"), _pairs(self.shift, "--shift COLUMN=NUMBER")
        ranges = _pairs(self.bounds, "--bounds NAME=LOW:HIGH")
        named = {
            "time": self.time, "time_unit": self.time_unit, "period": self.period, "hold": self.hold, "free": self.free,
            "longest": self.longest, "model_error": self.model_error, "offset": self.offset or None,
            "time_varying": self.time_varying or None,
            "columns": columns,
            "scale": {key: _number("--scale", text) for key, text in scales.items()},
            "shift": {key: _number("--shift", text) for key, text in shifts.items()},
            "bounds": {key: [_number("--bounds", end) for end in text.split(":")] for key, text in ranges.items()},
        }  # fmt: skip
        filled = {key: value for key, value in named.items() if value not in (None, [], {})}
        table.setdefault("identify", {}).update(filled)
        for override in self.set or []:
            config.override(table, override)
        return config.parse(table, str(self.pipeline))


def _pairs(texts: list[str] | None, form: str) -> dict[str, str]:
    pairs = [text.partition("=") for text in texts or []]
    for key, sign, value in pairs:
        if not (key and sign and value):
            raise ConfigError(f"expected {form}, got {key + sign + value!r}; write both with = between them")
    return {key: value for key, _, value in pairs}


def _number(flag: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"{flag}: expected a number, got {text!r}; write one, as 0.01") from None


def identify(
    options: Recorded,
    *,
    output: Annotated[
        Path | None, flag("Write the pipeline here; by default LOG's name with .toml.", "-o", "--output")
    ] = None,
    accept: Annotated[
        bool, flag("If the delay is not identifiable, take its possible range as bounds of D_hat.", "--accept")
    ] = False,
    joints: Annotated[
        bool,
        flag("Print a table of delay and lag of each joint, as action[0] and observation.state[0].", "--joints"),
    ] = False,
) -> None:
    """The answer of the stage; the page and the pipeline are written beside each other. With `joints` only a table.

    Raises UnmetError where no pipeline is written: the model is refused, or the delay is not identifiable and not
    accepted, or `npred plants check` would say no of the pipeline.
    """
    if joints:
        _joints(options, output, accept)
        return
    if output and "=" in output.name and output.suffix != ".toml":
        cure = f"an output of the plant and its column are --output-column {output}"
        raise ConfigError(f"--output: expected the file of the pipeline, got {str(output)!r}; {cure}")
    artifact = bring(options, ["identify"])[-1].artifact
    result, plant = IdentifiedResult.read(artifact.folder), options.planner().plant
    if not options.json:  # the check of the pipeline takes longer
        options.console.out("\n".join(result.sentences))
    path = output or Path(f"{options.stem}.toml")
    page = path.with_suffix(".html")
    try:
        shutil.copyfile(artifact.folder / PAGE, page)
    except OSError as error:
        todo = "name another by -o"
        raise ConfigError(f"{page}: expected a file that can be written, got: {error.strerror}; {todo}") from None
    files, remarks, refusal = [page], [], ""
    unknown = [span for span, certain in zip(result.interval, result.identifiable, strict=True) if not certain]
    if result.refused:
        refusal = "the recording contradicts the model; change the plant, or record more"
    elif not np.isfinite(unknown).all():
        refusal = "the recording leaves no bounded range of the delay; give --longest, or record more steps"
    elif unknown and not accept:
        spans = " and ".join(f"{low:.4g} to {high:.4g}" for low, high in unknown)
        refusal = f"the recording does not determine the delay; --accept takes the possible range, {spans}"
        refusal = f"{refusal} {plant.time_unit}".rstrip()
    else:
        target = rewritable(path, "identify")
        try:
            tables, remarks = pipeline.composed(options.config, plant, result, path)
        except ConfigError as error:
            refusal = str(error)
        else:
            head = "".join(f"# {line}\n" for line in [*result.sentences, *remarks])
            logs = " ".join(log.name for log in options.logs)
            path.write_text(f"{target} {logs}\n{head}\n{dumps(tables)}", encoding="utf-8")
            files.append(path)
    said = "\n".join([*remarks, *(f"wrote {file}" for file in files)])
    options.show(result.json_object() | {"remarks": remarks, "files": list(map(str, files))}, lambda: said)
    if refusal:
        raise UnmetError(f"no pipeline was written: {refusal}")


def _joints(options: Recorded, output: Path | None, accept: bool) -> None:
    """Print the delay and the lag of each joint. Raises ConfigError for flags that are not for that."""
    from npred.identification import joints

    unused = [flag.name for flag in fields(Recorded) if flag.name not in FOR_JOINTS
              and getattr(options, flag.name) not in (None, False)]  # fmt: skip
    unused += ["output"] * (output is not None) + ["accept"] * accept
    if unused:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in unused)
        raise ConfigError(f"--joints: expected none of the flags of a plant, got {flags}; drop it")
    reading = {"time": options.time, "time_unit": options.time_unit, "period": options.period}
    tasks, notes = joints.tasks(options.logs, options.longest, **reading)
    jobs = min(options.jobs or devices.cores(), len(tasks))
    with announce("identifying joints", 3.0 * len(tasks) / jobs), executors.opened(executors.LOCAL, jobs) as executor:
        answers = {task.name: answer for task, answer in executors.completed(executor, joints.identified, tasks)}
    every = [answers[task.name] for task in tasks]
    rows = [[joint.name, joint.command, joint.measured, *_numbers(joint)] for joint in every]
    header = ["joint", "command", "position", "delay (s)", "95 %", "lag (s)", "95 %", "gain"]
    reasons = [f"{joint.name}: {joint.why}" for joint in every if joint.why]
    document = {"joints": [plain(asdict(joint)) for joint in every], "notes": notes}
    width = options.console.width
    options.show(document, lambda: "\n".join([*notes, columns(header, rows, width), *reasons]))


def _numbers(joint: Any) -> list[str]:
    """Delay, lag and gain in words; a dash for a delay that is only a range, and for what is not known."""
    delay, bounded = f"{joint.delay:.4g}" if joint.certain else "–", np.isfinite(joint.lag_interval).all()
    ends = [" to ".join(f"{end:.4g}" for end in each) for each in (joint.delay_interval, joint.lag_interval)]
    return [delay, ends[0], *((f"{joint.lag:.4g}", ends[1], f"{joint.gain:.3g}") if bounded else "–––")]
