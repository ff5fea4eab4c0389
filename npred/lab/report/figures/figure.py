"""A figure as data: panels, each a function that draws on any axes.

A page shows each panel by itself, as SVG in the colours of the page; a file for a paper has all panels and the legend.
"""

import io
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from npred.lab.config.results import PredictorId
from npred.lab.report.figures.style import MEDIA, ROLES, SCREEN, Axes, LineStyle, Style, lettered, line_of, log, medium
from npred.plants.notation import SUBSCRIPT, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

FORMATS = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {"Software": None}}  # without dates
DPI = 300
LINE = 1.6  # sizes of a letter: a line of a legend
COLOURS = {light: role for role, (light, _) in ROLES.items()}


@dataclass(frozen=True)
class Panel:
    """One pair of axes: its title names the upward axis, `alt` describes the picture in words."""

    title: str
    alt: str
    draw: Callable[[Axes], None]


@dataclass(frozen=True)
class LegendEntry:
    """An entry of a legend."""

    label: str
    style: LineStyle


@dataclass(frozen=True)
class Figure:
    """A figure of several panels with one legend; `name` is its file's, `caption` explains it."""

    name: str
    title: str
    caption: str
    panels: Sequence[Panel]
    legend: Sequence[LegendEntry] = ()


def curves(lines: Iterable[tuple[Any, ...]], xlabel: str, *logarithmic: str, **limits: Any) -> Callable[[Axes], None]:
    """A function that draws lines (style, x, y), or bands (style, x, y, low) that are shaded down to `low`.

    On a logarithmic side, "x" or "y", only what is positive and finite is drawn. `limits` are xlim and ylim.
    """
    lines = list(lines)

    def shown(side: str, values: Any) -> Any:
        values = np.asarray(values)
        return np.where(np.isfinite(values) & (values > 0), values, np.nan) if side in logarithmic else values

    def draw(axis: Axes) -> None:
        axis.set(xlabel=xlabel, **limits)  # first, or the range of lost loops is found too, and overflows
        for style, x, y, *lows in lines:
            axis.plot(shown("x", x), shown("y", y), **style.line)
            for low in lows:
                axis.fill_between(x, shown("y", low), shown("y", y), color=style.colour, alpha=0.14, linewidth=0)
        log(axis, *logarithmic)

    return draw


def legend(predictors: Sequence[PredictorId]) -> list[LegendEntry]:
    return [LegendEntry(predictor.label, line_of(predictor)) for predictor in predictors]


def write(figure: Figure, folder: Path, style: Style = MEDIA["ieee2"], formats: Sequence[str] = ("svg", "png")) -> None:
    """The figure as name.svg, name.pdf, name.png: the same bytes for the same data."""
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

    columns = min(style.columns, len(figure.panels))
    rows = -(-len(figure.panels) // columns)
    with medium(style):
        across = style.columns_of([entry.label for entry in figure.legend])
        above = LINE * style.font / 72 * -(-len(figure.legend) // across)  # the legend, which takes no panel its height
        canvas = _canvas(style.width, rows * style.height * (1.0 if columns > 1 else 1.5) + above)
        axes = np.ravel(canvas.subplots(rows, columns, squeeze=False))
        for panel, axis in zip(figure.panels, axes, strict=False):
            panel.draw(axis)
            axis.set_title(panel.title)
        for axis in axes[len(figure.panels) :]:
            axis.set_visible(False)
        if figure.legend:
            lines = [Line2D([], [], label=entry.label, **entry.style.line) for entry in figure.legend]
            canvas.legend(handles=lines, loc="outside upper center", ncols=across)
        for text in canvas.findobj(Text):
            text.set_text(lettered(text.get_text()))
        for line in canvas.findobj(Line2D):  # as thick beside the letters as on a page
            line.set_linewidth(style.font / SCREEN.font * line.get_linewidth())
        _lay_out(canvas)  # which takes longest: once for all formats
        canvas.set_layout_engine(None)
        for form in formats:
            path = folder / f"{figure.name}.{form}"
            canvas.savefig(path, metadata=FORMATS[form], dpi=DPI, facecolor="white", format=form)


def _canvas(width: float, height: float) -> "Canvas":
    """An empty matplotlib figure of that many inches, free of pyplot's global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(canvas)
    return canvas


def _lay_out(canvas: "Canvas") -> None:
    """Lay a figure out; names beside an axis that has no room for them are left to the legend."""
    from matplotlib.ticker import FixedLocator, NullFormatter

    canvas.draw_without_rendering()
    for axis in [axis for panel in canvas.axes for axis in (panel.xaxis, panel.yaxis)]:
        boxes = [label.get_window_extent() for label in axis.get_ticklabels()]
        crowded = any(one.overlaps(other) for one, other in pairwise(boxes))
        if crowded and isinstance(axis.get_major_locator(), FixedLocator):
            axis.set_major_formatter(NullFormatter())
            canvas.draw_without_rendering()


def inline(panel: Panel, prefix: str) -> str:
    """The panel as an <svg> element of a page: its colours are CSS variables, its text is text, and it is described.

    `prefix` makes its identifiers unique on the page.
    """

    def shorter(number: re.Match[str]) -> str:
        return f"{float(number[0]):.2f}".rstrip("0").rstrip(".")

    def lowered(text: str) -> str:  # subscripts as spans below the line; what follows one comes back up
        first, *parts = SUBSCRIPT.split(text)
        spans = ""
        for below, after in zip(parts[::2], parts[1::2], strict=True):
            spans += f'<tspan font-size="72%" dy=".35em">{below}</tspan>'
            spans += f'<tspan dy="-.252em">{after}</tspan>' if after else ""
        return first + spans

    buffer = io.StringIO()
    with medium(SCREEN):
        canvas = _canvas(SCREEN.width, SCREEN.height)
        panel.draw(canvas.subplots())  # without its title: the page says it, in its type
        _lay_out(canvas)
        canvas.set_layout_engine(None)
        canvas.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    drawn = buffer.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", drawn[drawn.index("<svg") :], flags=re.DOTALL)
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda name: f' id="{prefix}-{name[1]}"' if name[1] in used else "", svg)
    svg = re.sub(r'(?:xlink:)?(href="|url\()#', rf"\1#{prefix}-", svg)
    svg = re.sub(r"'DejaVu Sans'[^;\"]*", "inherit", svg)
    svg = re.sub("|".join(COLOURS), lambda colour: f"var(--{COLOURS[colour[0]]})", svg)
    numbers = re.compile(r'(?<= )(?:d|points|transform|x|y)="[^"]*"')
    svg = numbers.sub(lambda part: re.sub(r"-?\d+\.\d+", shorter, part[0]), svg)
    svg = re.sub(r"(<text[^>]*>)([^<]*)", lambda text: text[1] + lowered(text[2]), svg)
    words = {name: f'<{name} id="{prefix}-{name}">{escape(plain(text))}</{name}>'
             for name, text in (("title", panel.title), ("desc", panel.alt))}  # fmt: skip
    head, body = svg.split(">", 1)
    head = re.sub(r' (?:width|height|version|xmlns:xlink)="[^"]*"', "", head)  # the page gives it its size
    head += f' role="img" aria-labelledby="{prefix}-title {prefix}-desc"'
    return f"{head}>{words['title']}{words['desc']}{body}".strip()
