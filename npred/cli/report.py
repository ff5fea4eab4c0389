"""A pipeline's page, or its figures and tables for a paper: they say what made them, and those of another pipeline of
that name do not overwrite them.
"""

import hashlib
import html
import os
import re
from collections.abc import Callable
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from npred.base import json_files
from npred.base.errors import ConfigError
from npred.cli.options import Piped, Work
from npred.lab.stages.report import UNFINISHED

if TYPE_CHECKING:
    from npred.lab.report.figures.style import Style
    from npred.lab.stages.report.report import PipelineResults

NAME = "report.html"  # in a result
SIGNATURE = "pipeline.txt"  # in a folder of figures or tables: the pipeline file that they are of
PLACE = "<!-- made from -->"  # in the header of that page, which knows neither files nor flags
OWNER = re.compile('<p class="about" data-pipeline="([^"]*)">')
HEAD = 2**16  # bytes of a page that its header is in
FORMATS = ("pdf", "svg", "png")  # formats of each figure


def place(options: Work, output: Path | None) -> Path:
    """The file of the page: `output`, by default the pipeline's name in the store.

    Where that name is another pipeline's, the page gets a second one, and a line says so.
    """
    return output or free_path(options, options.pipeline.stem, lambda name: options.store / f"{name}.html")


def is_complete(path: Path) -> bool:
    """True if there is a page of a run that ended."""
    with suppress(OSError):
        return UNFINISHED not in json_files.regular(path).read_text(encoding="utf-8", errors="replace")
    return False


def publish(options: Work, folder: Path, path: Path, asked: bool) -> Path:
    """Copy the page of a report to its place, name the pipeline that made it, and give that place.

    A store that cannot be written leaves the page where it is. Raises ConfigError for a place that was `asked` for and
    cannot be written.
    """
    source, aside = source_of(options), path.with_name(path.name + ".part")
    flags = "".join(f" <code>--set {html.escape(override)}</code>" for override in options.set or [])
    # The comment that a pipeline file begins with: what it is for, such as a test whose numbers mean nothing
    lines = options.pipeline.read_text(encoding="utf-8", errors="replace").splitlines()
    intent = " ".join(line.lstrip("# ") for line in takewhile(lambda line: line.startswith("#"), lines))
    name, said = html.escape(source), f". {html.escape(intent)}" if intent else ""
    made_from = f"From <code>{name}</code>{' with' if flags else ''}{flags}{said}"
    try:
        text = (folder / NAME).read_text(encoding="utf-8")
        text = text.replace(PLACE, f'<p class="about" data-pipeline="{name}">{made_from}</p>', 1)
        aside.write_text(text, encoding="utf-8", errors="backslashreplace")
        aside.replace(path)  # a browser that reads it meanwhile sees the old page or the new one
    except OSError as error:
        if not asked:
            return folder / NAME
        raise ConfigError(f"{path}: expected a file that can be written, got: {error.strerror}; name another") from None
    return path


def write_figures(results: "PipelineResults", folder: Path, style: "Style") -> list[Path]:
    """The files of the figures and tables, written in the style of a medium; a folder is made where there is none."""
    from npred.lab.report.figures import write

    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, figure in results.figures().items():
        write(figure, folder, style, FORMATS)
        files += [folder / f"{name}.{form}" for form in FORMATS]
    for name, table in results.tables().items():
        for form, text in (("csv", table.csv()), ("tex", table.latex())):
            files.append(folder / f"{name}.{form}")
            files[-1].write_text(text, encoding="utf-8")
    return files


def source_of(options: Piped) -> str:
    """The pipeline file, from the folder that the store is in: a folder that is moved or copied whole stays itself."""
    return Path(os.path.relpath(options.pipeline.absolute(), options.store.absolute().parent)).as_posix()


def free_path(options: Piped, name: str, of: Callable[[str], Path]) -> Path:
    """`of(name)`, a page or a folder; where another pipeline has it, with the folder's name or a digest, and a note."""
    source, folder = source_of(options), re.sub(r"[^\w.-]", "_", options.pipeline.absolute().parent.name)
    names = [name, f"{name}-{folder}", f"{name}-{hashlib.sha256(os.fsencode(source)).hexdigest()[:8]}"]
    owners = {path: _owner(path) for path in map(of, names)}
    first = next(iter(owners))
    path = min(owners, key=lambda path: (owners[path] != source, owners[path] is not None))
    if path != first and owners[first]:
        options.console.note(f"{first} belongs to {owners[first]}; the one of {source} is {path}")
    return path


def sign(options: Piped, folder: Path) -> None:
    """Say in a folder of results of which pipeline file they are."""
    (folder / SIGNATURE).write_text(source_of(options) + "\n", encoding="utf-8", errors="surrogateescape")


def _owner(path: Path) -> str | None:
    """The pipeline that a page or a folder names; None where there is none, or none is named."""
    try:
        if path.is_dir():
            return (path / SIGNATURE).read_text(encoding="utf-8", errors="surrogateescape").strip() or None
        with json_files.regular(path).open("rb") as file:
            owner = OWNER.search(file.read(HEAD).decode("utf-8", errors="replace"))
    except OSError:
        return None
    return html.unescape(owner[1]) if owner else None
