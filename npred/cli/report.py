"""`npred report`: the page of a pipeline, or its figures and tables for a paper."""

from pathlib import Path
from typing import TYPE_CHECKING

from npred.cli import execute
from npred.cli.options import Work, writable_folder
from npred.cli.page import page_path, sign
from npred.errors import ConfigError
from npred.store import durable

if TYPE_CHECKING:
    from npred.figures.style import Style
    from npred.stages.report.report_data import Story

FORMATS = ("pdf", "svg", "png")


def report(options: Work, output: Path | None, figures: str | None) -> None:
    """The page, or with a medium its figures and tables, as files. Raises ConfigError for no such medium."""
    if figures is None or options.dry_run:
        execute.stage(options, "report", output=output)
    else:
        _figures(options, output, figures)


def _figures(options: Work, output: Path | None, medium: str) -> None:
    from npred import plants
    from npred.figures.style import MEDIA
    from npred.stages.report.report_data import Story

    if medium not in MEDIA:
        raise ConfigError(f"--figures: expected {', '.join(MEDIA)}, got {medium!r}; name one of them")
    default = page_path(options, options.pipeline.stem, lambda name: options.store / f"{name}-{medium}")
    target = writable_folder(output or default, "figures")
    outcomes = execute.bring(options, ["evaluate", "bench"], borrows=True)
    folders = {done.node.name: done.artifact.folder for done in outcomes}
    plant = plants.resolve(options.config.plant, options.config.parameters)
    story = Story.read(options.config, plant, folders)
    with durable.room(target):
        _write(story, target, MEDIA[medium])
        if output is None:
            sign(options, target)
    files = [f"{plate}.{form}" for plate in story.plates() for form in FORMATS]
    files += [f"{table}.{form}" for table in story.tables() for form in ("csv", "tex")]
    options.show({"folder": str(target), "files": files}, lambda: "\n".join(str(target / file) for file in files))


def _write(story: "Story", target: Path, style: "Style") -> None:
    from npred.figures import write

    target.mkdir(parents=True, exist_ok=True)
    for plate in story.plates().values():
        write(plate, target, style, FORMATS)
    for table in story.tables().values():
        (target / f"{table.name}.csv").write_text(table.csv(), encoding="utf-8")
        (target / f"{table.name}.tex").write_text(table.latex(), encoding="utf-8")
