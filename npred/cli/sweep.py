"""`npred sweep`: every cell of a sweep grid from the store or made, one table, and the front as a figure."""

import csv
import io
from pathlib import Path

from npred.cli import sweep_table
from npred.cli.options import Running, writable_folder
from npred.cli.report import free_path, sign
from npred.cli.sweep_table import Row
from npred.errors import ConfigError, NpredError, room_on_disk, unlisted
from npred.parallel import devices, executors
from npred.pipeline import STAGES, CellRun, Outcome, Planner, Runner, nodes, remember
from npred.pipeline.cells import Cell, cells
from npred.progress import counted
from npred.terminal.console import columns

PRECISION = 4  # digits of the table that people read
Done = list[tuple[Cell, CellRun]]
Table = list[dict[str, str | float | None]]


def sweep(options: Running, to: str, output: Path | None, csv: bool) -> None:
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
    if options.dry_run:
        _show_plan(options, sweep_cells, targets, device)
        return
    jobs = options.jobs or devices.cores()
    remember(options.results, options.pipeline)
    options.console.keep_log(options.store, options.pipeline.stem)
    with executors.opened(options.executor, jobs) as executor:
        planners = [Planner(cell.config, options.results, device) for cell in sweep_cells]
        runs = Runner(options.console, jobs, executor).sweep(planners, targets)
    _report(options, list(zip(sweep_cells, runs, strict=True)), output, csv)


def _show_plan(options: Running, sweep_cells: list[Cell], targets: list[str], device: str) -> None:
    lines = []
    for cell in sweep_cells:
        steps = Planner(cell.config, options.results, device).plan(nodes(cell.config, targets))
        lines.append({"cell": cell.name, "stages": [f"{step.node.title}: {step.action}" for step in steps]})
    options.show({"cells": lines}, lambda: "\n".join("  ".join([line["cell"], *line["stages"]]) for line in lines))


def _report(options: Running, done: Done, output: Path | None, csv: bool) -> None:
    fine, lost = [(c, run) for c, run in done if not run.failure], [(c, run) for c, run in done if run.failure]
    rows = [row for cell, run in fine for row in sweep_table.rows(cell, run)]
    fronts = sweep_table.front([row.numbers for row in rows])
    table: Table = [{"row": k, **row.cells(), "front": fronts[k - 1]} for k, row in enumerate(rows, 1)]
    files = _write(options, done[0][0].config.name, output, rows, table) if rows else []
    if csv:
        options.console.out(_csv(table).rstrip("\n"))
    else:
        options.show(_document(done, table, files), lambda: _text(len(fine), table, files, options.console.width))
    if lost:
        (cell, run), *more = lost
        others = f"; and {len(more)} more, as --json says" if more else ""
        raise NpredError(f"sweep: {len(lost)} of {len(done)} cells failed: {cell.name}: {run.failure}{others}")


def _write(options: Running, name: str, output: Path | None, rows: list[Row], table: Table) -> list[Path]:
    """table.csv, and front.svg and front.png where there are two quantities to draw."""
    folder = output or free_path(options, name, lambda name: Path(f"sweep-{name}"))
    with room_on_disk(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "table.csv").write_text(_csv(table), encoding="utf-8")
        if output is None:
            sign(options, folder)
        return [folder / "table.csv", *sweep_table.draw(folder, rows)]


def _csv(table: Table) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(table[0]) if table else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    return text.getvalue()


def _document(done: Done, table: Table, files: list[Path]) -> dict[str, object]:
    listed = [
        {
            "set": cell.values, "state": "failed" if run.failure else "done", "error": run.failure or None,
            "stages": [_stage(outcome) for node in run.nodes if (outcome := run.outcomes.get(node.name))],
        }
        for cell, run in done
    ]  # fmt: skip
    count = sum(not run.failure for _, run in done)
    return {"total": len(done), "done": count, "cells": listed, "rows": table, "files": [str(file) for file in files]}


def _stage(outcome: Outcome) -> dict[str, object]:
    shared = {"stage": outcome.node.stage, "model": outcome.node.model, "action": outcome.action}
    return shared | {"seconds": round(outcome.seconds, 3), "key": outcome.key}


def _text(done: int, table: Table, files: list[Path], width: int | None) -> str:
    if not table:
        return f"done: {counted(done, 'cells')}; rows come from train on" if done else "no cell is done"
    shown = [name for name in table[0] if any(row[name] is not None for row in table)]
    text = columns(shown, [[_cell(row[name]) for name in shown] for row in table], width)
    return "\n".join([text, *map(str, files)])


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "*" if value else ""
    return f"{value:.{PRECISION}g}" if isinstance(value, float) else "∞" if value is None else str(value)
