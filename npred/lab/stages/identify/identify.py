"""The identify stage: a recording read, the plant fitted to it, a page of the answer."""

from collections.abc import Iterable
from typing import Any

import h5py
import numpy as np

from npred.base.errors import ConfigError
from npred.identification.identified import WORDS, Identified, held_back_unit
from npred.identification.identify import Reading, Settings, of_log, recorded
from npred.lab.config import dumps
from npred.lab.config.results import IdentifiedResult
from npred.lab.report.figures import identified as drawings
from npred.lab.report.figures.figure import Figure, write
from npred.lab.report.figures.table import Column, Table
from npred.lab.scheduler.job import Job
from npred.lab.stages.report import html_page

PAGE = "page.html"
LAGS = 40
ABSURD = 1e12  # a number of this size says only that there is no limit


def run(job: Job) -> IdentifiedResult:
    """Write page.html, its figures, and identified.h5 with their arrays."""
    table, plant = job.config.optional("identify"), job.plant
    if not table.files:
        cure = "name one by data in [identify], or npred identify LOG"
        raise ConfigError(f"identify: expected a recording, got none; {cure}")
    keys = dict(table)  # npred.identify takes the same names
    reading = {key: keys[key] for key in keys.keys() & Reading.__annotations__}
    log, notes = recorded(plant, table.files[0] if len(table.files) == 1 else table.files, **reading)
    settings = {key: keys[key] for key in keys.keys() & Settings.__dataclass_fields__}
    identified = of_log(plant, log, Settings(**settings, seed=job.config.seed), notes)
    drawn = _drawn(identified)
    with h5py.File(job.folder / "identified.h5", "w") as file:
        for name, values in drawn.items():
            file[name] = values
    windows = identified.windows
    least, most = np.nanmin(log.Y, axis=0, initial=np.inf), np.nanmax(log.Y, axis=0, initial=-np.inf)
    ranges = zip(plant.outputs, least.tolist(), most.tolist(), strict=True)
    lists = windows and {"t": windows.t.tolist(), "D": windows.D.tolist(), "interval": windows.interval.tolist()}
    result = IdentifiedResult(
        plant=plant.name,
        inputs=list(plant.inputs),
        D=identified.D.tolist(),
        interval=identified.interval.tolist(),
        identifiable=identified.identifiable.tolist(),
        parameters=identified.parameters,
        parameter_intervals=identified.parameter_intervals,
        held_back=identified.held_back,
        held_back_unit=held_back_unit(plant, identified.details["findings"].validation),
        sentences=identified.sentences,
        refused=identified.refused,
        ranges={name: (low, high) for name, low, high in ranges if low <= high},
        samples=len(log.t),
        period=log.period,
        **({"windows": lists} if lists else {}),
    )
    figures = list(drawings.figures(plant, drawn))
    for figure in figures:
        write(figure, job.folder)
    (job.folder / PAGE).write_text(_page(job, result, figures), encoding="utf-8")
    return result


def summary(result: IdentifiedResult, width: int | None = None) -> str:
    return "\n".join(result.sentences)


def _drawn(identified: Identified) -> dict[str, Any]:
    """The arrays that the figures draw."""
    estimate, log, m = identified.details["estimate"], identified.details["log"], identified.plant.m
    segments, fit = estimate.problem.segments, estimate.fit
    fitted = estimate.problem.outputs(fit)[segments.mask]
    rises = [np.where(np.isfinite(p.costs), p.costs, np.nan) - p.costs.min() for p in estimate.profiles]
    profiles = {f"profile_{j}": np.stack([p.values, rises[j]]) for j, p in enumerate(estimate.profiles)}
    r = np.nan_to_num(fit.residuals)  # along their segments
    lags = range(min(LAGS, r.shape[1] - 1))
    products = np.array([(r[:, k:] * r[:, : r.shape[1] - k]).sum() / max(r.shape[1] - k, 1) for k in lags])
    empty, windows = np.zeros((0, m)), identified.windows
    return profiles | {
        "t": segments.t[segments.mask], "Y": segments.Y[segments.mask], "fitted": fitted, "t_U": log.t_U, "U": log.U,
        "D": identified.D, "interval": identified.interval, "level": float(estimate.levels.max()),
        "autocorrelation": products / max(products[0], 1e-300),
        "window_t": windows.t if windows else empty[:, 0], "window_D": windows.D if windows else empty,
        "window_interval": windows.interval if windows else np.zeros((0, m, 2)),
    }  # fmt: skip


def _page(job: Job, result: IdentifiedResult, figures: list[Figure]) -> str:
    """The page, with a table of each delay and parameter and its interval, and one of the rivals' errors."""
    table, plant = job.config.optional("identify"), job.plant
    files = ", ".join(path.name for path in table.files)
    ends = [*result.interval, *result.parameter_intervals.values()]
    yes_or_no = ["yes" if certain else "no" for certain in result.identifiable] + ["–"] * len(result.parameters)
    columns = [
        Column("what", [*(f"delay of {name} ({plant.time_unit})" for name in result.inputs), *result.parameters]),
        Column("value", _limited([*result.D, *result.parameters.values()]), digits=4),
        Column("from", _limited([low for low, _ in ends]), digits=4),
        Column("to", _limited([high for _, high in ends]), digits=4),
        Column("identifiable", yes_or_no),
    ]
    rivals = [
        Column("model", [WORDS[name] for name in result.held_back]),
        Column(f"error, rms ({result.held_back_unit})", _limited(result.held_back.values()), digits=3),
    ]
    tables = [
        Table("identified", "With intervals of 95 %", columns),
        Table("rivals", "Predictions on the part of the recording that was held back", rivals),
    ]
    if windows := result.windows:
        for j, name in enumerate(result.inputs):
            low, high = np.array(windows["interval"], dtype=float)[:, j].T.tolist()
            rows = {"middle": windows["t"], "delay": np.array(windows["D"])[:, j].tolist(), "from": low, "to": high}
            over_time = [Column(head, _limited(values), digits=4) for head, values in rows.items()]
            tables.append(Table(f"windows-{j}", f"The delay of {name} by window ({plant.time_unit})", over_time))
    return html_page.filled(
        html_page.text("identified.html"),
        name=job.config.name,
        about=f"What {files} tells of plant {result.plant}: {result.samples} samples, one each "
        f"{plant.time_text(result.period)} in the median.",
        said=result.sentences,
        chapters=[],
        figures=figures,
        tables=[table for table in tables if table.rows],
        facts={"Recording": {"files": files, "samples": str(result.samples)}},
        settings=dumps({"plant": job.config.with_file_names().plant, "identify": table.with_file_names()}),
    )


def _limited(values: Iterable[float]) -> list[float | None]:
    """The values, None for an absurd one, which a table shows as a dash."""
    return [value if abs(value) < ABSURD else None for value in values]
