"""A figure as data: panels that draw on any axes; laid out together for a paper, or one by one for a page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from npred.figures.style import HANDLE, MEDIA, SCREEN, Axes, LineStyle, Style, lettered, medium

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {"Software": None}}  # without dates
DPI = 300
LETTER, GAP = 0.47, 2.3  # widths of an M: a letter of a legend, and what surrounds an entry


@dataclass(frozen=True)
class Panel:
    """One pair of axes: its title says what is drawn upwards, `alt` says in words what can be seen."""

    title: str
    alt: str
    draw: Callable[[Axes], None]


@dataclass(frozen=True)
class LegendEntry:
    """An entry of a legend."""

    label: str
    look: LineStyle


@dataclass(frozen=True)
class Figure:
    """A figure of several panels with one legend; `name` is its file's, `caption` what to see in it."""

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    keys: tuple[LegendEntry, ...] = ()


def draw(panel: Panel, axis: Axes) -> None:
    panel.draw(axis)
    axis.set_title(panel.title)


def write(plate: Figure, folder: Path, style: Style = MEDIA["ieee2"], formats: Sequence[str] = ("svg", "png")) -> None:
    """The plate as name.svg, name.pdf, name.png: the same bytes for the same data."""
    with medium(style):
        figure = _figure(plate, style)
        figure.draw_without_rendering()  # lays it out, which takes longest: once for all formats
        figure.set_layout_engine(None)
        for form in formats:
            figure.savefig(
                folder / f"{plate.name}.{form}", metadata=FORMATS[form], dpi=DPI, facecolor="white", format=form
            )


def canvas(width: float, height: float) -> "Figure":
    """An empty matplotlib figure of that many inches, free of pyplot's global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _figure(plate: Figure, style: Style) -> "Figure":
    columns = min(style.columns, len(plate.panels))
    rows = -(-len(plate.panels) // columns)
    figure = canvas(style.width, rows * style.height * (1.0 if columns > 1 else 1.5) + 0.04 * style.font)
    axes = np.ravel(figure.subplots(rows, columns, squeeze=False))
    for panel, axis in zip(plate.panels, axes, strict=False):
        draw(panel, axis)
    for axis in axes[len(plate.panels) :]:
        axis.set_visible(False)
    _legend(figure, plate, style)
    _set_letters(figure)
    _scale_lines(figure, style.font / SCREEN.font)
    return figure


def _legend(figure: "Figure", plate: Figure, style: Style) -> None:
    from matplotlib.lines import Line2D

    if plate.keys:
        lines = [Line2D([], [], label=key.label, **key.look.line) for key in plate.keys]
        figure.legend(handles=lines, loc="outside upper center", ncols=_columns(plate, style))


def _columns(plate: Figure, style: Style) -> int:
    """As many columns as fit beside each other; the entries are filled in column by column."""
    room = style.width * 72 / style.font
    for count in range(len(plate.keys), 1, -1):
        columns = np.array_split([LETTER * len(key.label) for key in plate.keys], count)
        if sum(column.max() + HANDLE + GAP for column in columns) < room:
            return count
    return 1


def _scale_lines(figure: "Figure", factor: float) -> None:
    """Lines as thick beside the letters as they are on a page."""
    from matplotlib.lines import Line2D

    for line in figure.findobj(Line2D):
        line.set_linewidth(factor * line.get_linewidth())


def _set_letters(figure: "Figure") -> None:
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_text(lettered(text.get_text()))
