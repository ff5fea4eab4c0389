"""`npred tune`: better numbers for the laws of a pipeline's loops, and a pipeline with them."""

from os.path import relpath
from pathlib import Path
from typing import Annotated, Any

from npred.base import devices
from npred.base.errors import ConfigError
from npred.cli.options import Working, flag, rewritable, writable
from npred.lab import config
from npred.lab.config import Pipeline, dumps
from npred.lab.config.results import BeforeAfter, Tuned
from npred.lab.config.section import map_paths
from npred.lab.report.terminal import interruption
from npred.lab.report.terminal.console import columns
from npred.lab.stages.tuning import LAW, LqrWeights
from npred.lab.stages.tuning import tune as search
from npred.plants import Plant


def tune(
    options: Working,
    *,
    free: Annotated[
        list[str] | None,
        flag("A number to search: gamma, b or a gain of kappa, and its range, as k1=0.5:5.", word="NAME[=LOW:HIGH]"),
    ] = None,
    output: Annotated[
        Path | None, flag("Write a pipeline with the new numbers.", "-o", "--output", word="FILE")
    ] = None,
) -> None:
    """The answer as a table before -> after; with `output` a pipeline with the new numbers, where there is a gain.

    Raises ConfigError for a flag, or a file of somebody else.
    """
    tables = config.table(options.pipeline)
    for override in options.set or []:
        config.override(tables, override)
    for text in free or []:
        name, sign, span = text.partition("=")
        table = tables.setdefault("tune", {})
        if name not in (*LAW, *table.setdefault("free", [])):
            table["free"].append(name)
        try:
            if sign:
                low, high = map(float, span.split(":"))
                table.setdefault("bounds", {})[name] = [low, high]
        except ValueError:
            raise ConfigError(f"--free: expected NAME or NAME=LOW:HIGH, got {text!r}; write k1=0.5:5, say") from None
    pipeline = config.parse(tables, str(options.pipeline))
    head = rewritable(writable(output), "tune") if output else ""
    planner = options.planner()
    with interruption.graceful("interrupted; the numbers are the best up to then"):
        result = search(pipeline, planner.plant, options.jobs or devices.cores(), options.console)
        text = _table(result, options.console.width)
        if output and result.gained:
            there = map_paths(tables, lambda file: relpath(file, output.parent))
            written = f"{head} {options.pipeline.name}\n# {result.sentence}\n\n"
            output.write_text(written + _pipeline(there, pipeline, planner.plant, result), encoding="utf-8")
            text += f"\nwrote {output}"
        elif output:
            text += "\nno pipeline was written"
        options.show(result.json_object(), lambda: text)


def _table(result: Tuned, width: int | None) -> str:
    """Each number, and what the held-out loops do, before and after, with the change over the starts."""
    rows = [[each.name, f"{each.before:.4g}", f"{each.after:.4g}", "", ""] for each in result.numbers]
    judged = result.held_out
    figures = {
        "settling time": judged.settle_time, "peak of |X - X*|": judged.peak, "effort, ∫ |U - U*|² dt": judged.effort,
        "cost": judged.cost, "cost, training": result.training.cost,
    }  # fmt: skip
    rows += [[name, *_cells(figure)] for name, figure in figures.items()]
    rows.append([f"of {judged.loops} loops do not settle", *map(str, judged.unsettled), "", ""])
    header = ["", "before", "after", "change", "95 % of it"]
    return f"{result.sentence}\n\n{columns(header, rows, width, {*header[1:]})}"


def _cells(figure: BeforeAfter) -> list[str]:
    values = ["–" if value is None else f"{value:.4g}" for value in (figure.before, figure.after)]
    if figure.gain is None or figure.interval is None:
        return [*values, "", ""]
    low, high = figure.interval
    return [*values, f"{-figure.gain:+.1%}", f"{-high:+.1%} to {-low:+.1%}"]


def _pipeline(tables: dict[str, Any], pipeline: Pipeline, plant: Plant, result: Tuned) -> str:
    """The pipeline with the new numbers: gamma and b in [evaluate], and in [generate] where its law is the same."""
    after = {each.name: float(f"{each.after:.6g}") for each in result.numbers}
    law = {name: value for name, value in after.items() if name in LAW}
    rest = {name: value for name, value in after.items() if name not in law and "." not in name}
    same = pipeline.generate.adaptation == pipeline.evaluate.adaptation
    changed = dict(tables) | {"parameters": tables.get("parameters", {}) | rest}
    for stage in ("evaluate", "generate") if same else ("evaluate",):
        changed[stage] = tables.get(stage, {}) | law
    weights = LqrWeights.of(plant)
    if weights and weights.present.keys() & after.keys():
        changed["kappa"] = weights.table(after)
    return dumps(changed)
