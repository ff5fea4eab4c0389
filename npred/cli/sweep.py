"""What `npred sweep` does: every cell of a grid from the store or made, one table, and the front as a figure."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from npred.cli import execute
from npred.cli.options import Running, writable_folder
from npred.errors import ConfigError, NpredError
from npred.parallel import devices, executors
from npred.pipeline import Planner, nodes
from npred.store import durable
from npred.sweep import Cell, Progress, Sweep, cells, sweep_table
from npred.terminal.console import columns
from npred.terminal.progress_bars import counted

PRECISION = 4  # digits of the table that people read


@dataclass(frozen=True)
class Wanted:
    """The last stage, the folder of the table and figure (None: by the pipeline's name), CSV on stdout."""

    to: str
    output: Path | None
    csv: bool


def sweep(options: Running, wanted: Wanted) -> None:
    """Run the grid. Raises NpredError, once all the others are done, where a cell failed."""
    if wanted.to not in sweep_table.stages():
        raise ConfigError(
            f"--to: expected one of {', '.join(sweep_table.stages())}, got {wanted.to!r}; name one of them"
        )
    if wanted.output:
        writable_folder(wanted.output, "table")
    device = devices.resolve(options.device)
    devices.require(device)
    grid, targets = cells(options.pipeline, options.set or []), sweep_table.targets(wanted.to)
    if options.dry_run:
        _planned(options, grid, targets, device)
        return
    jobs = options.jobs or devices.cores()
    options.results.remember(options.pipeline)
    execute.keep_log(options)
    with executors.opened(options.executor, jobs) as executor:
        found = Sweep(options.results, device, options.console, jobs, executor).run(grid, targets)
    _report(options, wanted, found)


def _planned(options: Running, grid: list[Cell], targets: list[str], device: str) -> None:
    rows = []
    for cell in grid:
        steps = Planner(cell.config, options.results, device).plan(nodes(cell.config, targets))
        rows.append([cell.name, *(f"{step.node.title}: {step.action}" for step in steps)])
    document = {"cells": [{"cell": name, "stages": stages} for name, *stages in rows]}
    options.show(document, lambda: "\n".join("  ".join(row) for row in rows))


def _report(options: Running, wanted: Wanted, found: list[Progress]) -> None:
    fine, lost = [p for p in found if not p.error], [p for p in found if p.error]
    rows = _rows(fine)
    files = _write(wanted.output or Path(f"sweep-{found[0].cell.config.name}"), rows) if rows else []
    if wanted.csv:
        options.console.out(_csv(rows).rstrip("\n"))
    else:
        options.show(_document(found, rows, files), lambda: _told(len(fine), rows, files, options.console.width))
    if lost:
        first = f"{lost[0].cell.name}: {lost[0].error}"
        others = f"; and {len(lost) - 1} more, as --json says" if len(lost) > 1 else ""
        raise NpredError(f"sweep: {len(lost)} of {len(found)} cells failed: {first}{others}")


def _rows(found: list[Progress]) -> list[dict[str, Any]]:
    from npred.sweep import pareto

    rows = [row for progress in found for row in sweep_table.rows(progress)]
    marked = zip(rows, pareto.front(rows), strict=True)
    return [{"row": number, **row, "front": best} for number, (row, best) in enumerate(marked, 1)]


def _write(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    """table.csv, and front.svg and front.png where there are two quantities to draw."""
    from npred.sweep import pareto

    with durable.room(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "table.csv").write_text(_csv(rows), encoding="utf-8")
        return [folder / "table.csv", *pareto.draw(folder, rows)]


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _document(found: list[Progress], rows: list[dict[str, Any]], files: list[Path]) -> dict[str, Any]:
    listed = [
        {"set": p.cell.values, "state": "failed" if p.error else "done", "error": p.error or None, "stages": _stages(p)}
        for p in found
    ]
    done = sum(not p.error for p in found)
    return {"total": len(found), "done": done, "cells": listed, "rows": rows, "files": [str(file) for file in files]}


def _stages(progress: Progress) -> list[dict[str, Any]]:
    return [
        {
            "stage": node.stage, "model": node.model, "action": made.action, "seconds": round(made.seconds, 3),
            "key": made.artifact.manifest.key if made.artifact else None,
        }
        for node in progress.nodes
        if (made := progress.made.get(node.name))
    ]  # fmt: skip


def _told(done: int, rows: list[dict[str, Any]], files: list[Path], width: int | None) -> str:
    if not rows:
        return f"done: {counted(done, 'cells')}; rows come from train on" if done else "no cell is done"
    shown = [name for name in rows[0] if any(row[name] is not None for row in rows)]
    table = columns(shown, [[_text(row[name]) for name in shown] for row in rows], width)
    return "\n".join([table, *map(str, files)])


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "*" if value else ""
    return f"{value:.{PRECISION}g}" if isinstance(value, float) else "∞" if value is None else str(value)
