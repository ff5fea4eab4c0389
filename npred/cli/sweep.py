"""`npred sweep`: every cell of a sweep grid from the store or made, one table with a row per trained network of a cell,
and its front of accuracy, latency and radius as a figure: what no other network beats in all of them.
"""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from npred.base import devices
from npred.base.errors import ConfigError, NpredError, room_on_disk, unlisted
from npred.base.progress import counted
from npred.cli.options import Running, flag, writable_folder
from npred.cli.report import free_path, sign
from npred.lab.config.results import Benched, Evaluated, PredictorId, Trained, ranked
from npred.lab.report import figures
from npred.lab.report.figures.figure import Figure, Panel, legend
from npred.lab.report.figures.style import ROLES, Axes, line_of, log
from npred.lab.report.terminal.console import columns
from npred.lab.scheduler import executors
from npred.lab.scheduler.cells import Cell, cells
from npred.lab.scheduler.plan import STAGES, Planner, nodes
from npred.lab.scheduler.retention import remember
from npred.lab.scheduler.runner import CellRun, Runner

MEASURED = ("mse", "eps_sup", "eps_kappa", "radius", "radius_worst", "converged")
PRECISION = 4  # digits of the table that people read
AXES = {"eps_sup": "sup error ε", "latency_us": "µs per call", "radius_worst": "worst radius"}
PAIRS = (("latency_us", "eps_sup"), ("eps_sup", "radius_worst"), ("latency_us", "radius_worst"))
NAMED = 20  # points of the front that have their row of the table beside them
SMALLEST = 1e-16  # where a radius of 0 is drawn on a logarithmic axis
Numbers = Mapping[str, float | None]  # by column; None for what is not known, and for what is not finite


class Row(NamedTuple):
    """A trained network of a cell: the cell's values, its errors, radius and latency, and the artifact that says so."""

    values: Mapping[str, str]
    model: str
    numbers: Numbers
    artifact: str

    def cells(self) -> dict[str, str | float | None]:
        """All of them by column."""
        return {**self.values, "model": self.model, **self.numbers, "artifact": self.artifact}


Done = list[tuple[Cell, CellRun]]
Table = list[dict[str, str | float | None]]


def sweep(
    options: Running,
    *,
    to: Annotated[str, flag("The last stage of each cell; bench also measures latencies.", word="STAGE")] = "evaluate",
    output: Annotated[
        Path | None, flag("Folder for table and figure; by default sweep-NAME.", "-o", "--output", word="DIR")
    ] = None,
    csv: Annotated[bool, flag("Print the table as CSV.", "--csv")] = False,
) -> None:
    """Run the grid up to the stage `to`; table and figure go to the folder `output`, by default one of the pipeline's
    name, and with `csv` the table to stdout. Raises NpredError, once all the others are done, where a cell failed.
    """
    if to not in STAGES:
        raise ConfigError(unlisted("--to", to, STAGES))
    if output:
        writable_folder(output, "table")
    device = devices.resolve(options.device)
    devices.require(device)
    sweep_cells = cells(options.pipeline, options.set or [])
    targets = ["evaluate", "bench"] if to == "bench" else [to]  # a latency is worth little without its error
    planners = [Planner(cell.config, options.results, device) for cell in sweep_cells]
    if options.dry_run:
        lines = []
        for cell, planner in zip(sweep_cells, planners, strict=True):
            steps = planner.plan(nodes(cell.config, targets))
            lines.append({"cell": cell.name, "stages": [f"{step.node.title}: {step.action}" for step in steps]})
        options.show({"cells": lines}, lambda: "\n".join("  ".join([line["cell"], *line["stages"]]) for line in lines))
        return
    jobs = options.jobs or devices.cores()
    remember(options.results, options.pipeline)
    options.console.keep_log(options.store, options.pipeline.stem)
    with executors.opened(options.executor, jobs) as executor:
        runs = Runner(options.console, jobs, executor).sweep(planners, targets)
    done = list(zip(sweep_cells, runs, strict=True))
    rows = [row for cell, run in done if not run.failure for row in rows_of(cell, run)]
    fronts = front([row.numbers for row in rows])
    table: Table = [{"row": k, **row.cells(), "front": fronts[k - 1]} for k, row in enumerate(rows, 1)]
    files = _write(options, options.pipeline.stem, output, rows, table) if rows else []
    if csv:
        options.console.out(_csv(table).rstrip("\n"))
    else:
        options.show(_document(done, table, files), lambda: _text(done, table, files, options.console.width))
    if failed := [(cell, run) for cell, run in done if run.failure]:
        (cell, run), *more = failed
        others = f"; and {len(more)} more, as --json says" if more else ""
        raise NpredError(f"sweep: {len(failed)} of {len(done)} cells failed: {cell.name}: {run.failure}{others}")


def _write(options: Running, name: str, output: Path | None, rows: list[Row], table: Table) -> list[Path]:
    """table.csv, and front.svg and front.png where there are two quantities to draw."""
    folder = output or free_path(options, name, lambda name: Path(f"sweep-{name}"))
    with room_on_disk(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "table.csv").write_text(_csv(table), encoding="utf-8")
        if output is None:
            sign(options, folder)
        return [folder / "table.csv", *draw(folder, rows)]


def _csv(table: Table) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(table[0]) if table else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    return text.getvalue()


def _document(done: Done, table: Table, files: list[Path]) -> dict[str, object]:
    listed = []
    for cell, run in done:
        stages = []
        for outcome in (outcome for node in run.nodes if (outcome := run.outcomes.get(node.name))):
            shown = {"stage": outcome.node.stage, "model": outcome.node.model, "action": outcome.action}
            stages.append(shown | {"seconds": round(outcome.seconds, 3), "key": outcome.key})
        state = "failed" if run.failure else "done"
        listed.append({"set": cell.values, "state": state, "error": run.failure or None, "stages": stages})
    count = sum(not run.failure for _, run in done)
    return {"total": len(done), "done": count, "cells": listed, "rows": table, "files": [str(file) for file in files]}


def _text(done: Done, table: Table, files: list[Path], width: int | None) -> str:
    if not table:
        fine = sum(not run.failure for _, run in done)
        return f"done: {counted(fine, 'cells')}; rows come from train on" if fine else "no cell is done"

    def text(value: object) -> str:
        if isinstance(value, bool):
            return "*" if value else ""
        return f"{value:.{PRECISION}g}" if isinstance(value, float) else "∞" if value is None else str(value)

    shown = [name for name in table[0] if any(row[name] is not None for row in table)]
    return "\n".join([columns(shown, [[text(row[name]) for name in shown] for row in table], width), *map(str, files)])


def rows_of(cell: Cell, run: CellRun) -> Iterator[Row]:
    """A row for each network of a cell.

    Errors and radius are of the evaluate stage, or of the network's training where that is all that ran; the
    latency, in µs, is the fastest runtime's for one call at the bench stage's first dx.
    """
    artifacts = {name: outcome.artifact for name, outcome in run.outcomes.items()}
    times = Benched.read(artifacts["bench"].folder).table if "bench" in artifacts else []
    if "evaluate" in artifacts:
        models = Evaluated.read(artifacts["evaluate"].folder).models
        measured: Any = {contender: scores for contender, scores in models.items() if contender.is_network}
    else:
        trained = {node.model: artifacts[node.name].folder for node in run.nodes if node.model}
        measured = {PredictorId(model): Trained.read(folder) for model, folder in trained.items()}
    dx = cell.config.bench.dx[0]
    for contender, scores in measured.items():
        numbers = {"mse": scores.mse, "eps_sup": scores.eps_sup}
        if "evaluate" in artifacts:
            radius = scores.radius
            numbers |= {"eps_kappa": scores.eps_kappa, "radius": radius.median, "radius_worst": radius.worst}
            numbers |= {"converged": radius.converged}
        finite = {key: number for key, number in numbers.items() if math.isfinite(number)}
        rows_of = [row for row in times if row.predictor == contender.model and contender.epoch is None]
        latency = min((row.median_us for row in rows_of if abs(row.dx - dx) < dx / 10), default=None)
        source = list(artifacts)[-1] if "evaluate" in artifacts else contender.model
        every = {key: finite.get(key) for key in MEASURED} | {"latency_us": latency}
        yield Row(cell.values, contender.name, every, artifacts[source].name)


def dominated(points: np.ndarray) -> np.ndarray:
    """A mask (N,) of the points (N, k) for which another is nowhere larger and somewhere smaller."""
    beaten = [((points <= point).all(axis=1) & (points < point).any(axis=1)).any() for point in points]
    return np.array(beaten, dtype=bool)


def front(rows: Sequence[Numbers]) -> list[bool]:
    """One boolean per row of a table: it is on the front of those of error, latency and radius that are known.

    The radius of a loop that overflows, or an error that is not finite (None), is beaten by any number, and never on
    the front.
    """
    axes = [axis for axis in AXES if any(row[axis] is not None for row in rows)]
    points = np.array([[np.inf if row[axis] is None else row[axis] for axis in axes] for row in rows], dtype=float)
    if not axes:
        return [False] * len(rows)
    return (~dominated(points) & np.isfinite(points).all(axis=1)).tolist()


def draw(folder: Path, rows: Sequence[Row]) -> list[Path]:
    """Write front.svg and front.png, a panel for each two axes that are known; its numbers count the rows, from 1."""
    contenders = {each.name: each for each in ranked(PredictorId.parse(row.model) for row in rows)}
    panels = []
    for x, y in PAIRS:
        shown = {k: row for k, row in enumerate(rows, 1) if None not in (row.numbers[x], row.numbers[y])}
        if all(any(row.numbers[axis] is not None for row in rows) for axis in (x, y)):
            alt = f"{len(shown)} networks by {AXES[x]} and {AXES[y]}."
            panels.append(Panel(f"{AXES[y]} versus {AXES[x]}", alt, partial(_panel, shown, contenders, x, y)))
    if not panels:
        return []
    caption = "One point per row of the table; the line is the front, and its numbers are the table's rows."
    figures.write(Figure("front", "The front", caption, panels, legend([*contenders.values()])), folder)
    return [folder / "front.svg", folder / "front.png"]


def _panel(shown: dict[int, Row], contenders: dict[str, PredictorId], x: str, y: str, axis: Axes) -> None:
    points = np.array([[row.numbers[x], row.numbers[y]] for row in shown.values()], dtype=float).reshape(-1, 2)
    points = np.maximum(points, SMALLEST)
    for model in dict.fromkeys(row.model for row in shown.values()):
        of_model = np.array([row.model == model for row in shown.values()])
        axis.plot(*points[of_model].T, "o", color=line_of(contenders[model]).colour)
    best = ~dominated(points)
    order = np.flatnonzero(best)[np.argsort(points[best, 0])]
    axis.plot(*points[order].T, color=ROLES["muted"][0], zorder=0, drawstyle="steps-post")
    for k in order[:NAMED]:
        axis.annotate(str([*shown][k]), tuple(points[k]), xytext=(4, 3), textcoords="offset points")
    axis.set_xlabel(AXES[x])
    log(axis, "x", "y")
