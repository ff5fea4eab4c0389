"""The look of all figures: colours and lines of predictors, a page and papers, and readable ticks."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from npred.base.registry import NETWORKS
from npred.lab.config.results import NO_ADAPTATION, NUMERICAL, PredictorId
from npred.plants.notation import SUPERSCRIPTS, mathematics

if TYPE_CHECKING:  # takes a second
    import matplotlib.axes

Axes: TypeAlias = "matplotlib.axes.Axes"
# Near Okabe and Ito's colours, darker on a light page, which comes first, lighter on a dark one. What is close for some
# colour-blind readers, a network and the same stopped early, differs in its dashes or markers too.
ROLES = {
    "ink": ("#16191d", "#eceef0"),
    "muted": ("#6b737c", "#9aa3ad"),
    "grid": ("#dfe3e7", "#333a42"),
    "paper": ("#fefefe", "#14171b"),
    "fill": ("#d5dae0", "#3a424b"),
    "frozen": ("#b0588f", "#e39cc8"),
    "blue": ("#00639e", "#56b4e9"),
    "sky": ("#3d8fc4", "#a5d3f3"),
    "orange": ("#c74a00", "#ff9a52"),
    "amber": ("#b67509", "#f6cf8f"),
    "violet": ("#6a4bbd", "#b7a3f2"),
    "lilac": ("#9a80d6", "#dccffb"),
    "brown": ("#75501f", "#c79c5e"),
    "sand": ("#a07a48", "#e6cfa8"),
    "crimson": ("#ab0f33", "#ff8095"),
    "rose": ("#d4657c", "#ffc2cc"),
    "olive": ("#666b00", "#c9ce45"),
    "lime": ("#8a8f1f", "#e4e89b"),
    "green": ("#008f68", "#3fd0a4"),
}
# A network's colours, trained and stopped early: in the registry's order, then of networks that are not built in, by
# rank. Green and ink are the numerical methods'.
BUILTIN = (("blue", "sky"), ("orange", "amber"))
OTHERS = (("crimson", "rose"), ("olive", "lime"), ("violet", "lilac"), ("brown", "sand"))
# Dashes: of networks in turn, for one is drawn over another and over a solid line, each seen in the gaps of the next;
# those for whom no colour is left; networks that stopped early.
TRAINED, MORE, EARLY = ((6, 2.2), (3.2, 5)), (6, 1.6, 1, 1.6), (4, 1.6)


@dataclass(frozen=True)
class LineStyle:
    """Colour, dash and marker of a series, in figures and in the legends of a page."""

    role: str
    dash: tuple[float, ...] = ()
    width: float = 1.4
    marker: str = ""

    @property
    def colour(self) -> str:
        """On a light page."""
        return ROLES[self.role][0]

    @property
    def line(self) -> dict[str, Any]:
        """As matplotlib's plot takes it."""
        style = (0, self.dash) if self.dash else "-"
        return {"color": self.colour, "linestyle": style, "linewidth": self.width, "marker": self.marker or None}


DOTTED = LineStyle("muted", (1, 2), 1.2)  # theory, tolerances, where a loop is to go


def line_of(predictor: PredictorId) -> LineStyle:
    """The line of a predictor: the same in every figure."""
    if predictor == NUMERICAL:
        return LineStyle("ink", width=1.9)
    if predictor == NO_ADAPTATION:
        return LineStyle("frozen", (1.2, 1.4), 1.0)
    trained, early = colours(predictor)
    if predictor.epoch is not None:
        return LineStyle(early, EARLY)
    pairs, place = _palette(predictor)
    return LineStyle(trained, MORE if pairs is OTHERS and place >= len(OTHERS) else TRAINED[place % len(TRAINED)])


def colours(network: PredictorId) -> tuple[str, str]:
    """The roles of a network, trained and stopped early."""
    pairs, place = _palette(network)
    return pairs[place % len(pairs)]


def _palette(network: PredictorId) -> tuple[tuple[tuple[str, str], ...], int]:
    """The pairs of colours that a network takes one of, and which."""
    builtin = [*NETWORKS.builtin][: len(BUILTIN)]
    return (BUILTIN, builtin.index(network.model)) if network.model in builtin else (OTHERS, network.rank)


HANDLE = 2.4  # widths of an M: the line of a legend's entry
LETTER, GAP = 0.47, 2.3  # a letter of it, and the room around an entry


@dataclass(frozen=True)
class Style:
    """A page or a paper: width in inches, panels beside each other, points of text, its family, height of a panel."""

    width: float
    columns: int
    font: float
    family: str
    height: float

    def columns_of(self, labels: Sequence[str]) -> int:
        """As many columns of a legend's entries as fit beside each other; they are filled in column by column."""
        room = self.width * 72 / self.font
        for count in range(len(labels), 1, -1):
            columns = np.array_split([LETTER * len(label) for label in labels], count)
            if sum(column.max() + HANDLE + GAP for column in columns) < room:
                return count
        return 1


SCREEN = Style(300 / 72, 1, 9.5, "DejaVu Sans", 2.9)  # one panel on a page
MEDIA = {  # all panels in a file
    "ieee1": Style(3.5, 2, 6.5, "STIXGeneral", 1.35),
    "ieee2": Style(7.16, 3, 8, "STIXGeneral", 1.75),
    "page": Style(5.4, 2, 9, "DejaVu Sans", 1.9),  # legible on a telephone
}
_TURN = Lock()  # matplotlib's settings are the process's


@contextmanager
def medium(style: Style) -> Iterator[None]:
    """matplotlib in the style, for one thread at a time, and as it was afterwards."""
    import matplotlib

    ink, muted, grid = (ROLES[role][0] for role in ("ink", "muted", "grid"))
    settings: Any = {
        "svg.hashsalt": "npred",  # else the identifiers inside an SVG are random
        "svg.fonttype": "none" if style is SCREEN else "path",
        "axes.formatter.use_mathtext": style is not SCREEN,  # a page's fonts have the letters and signs, few others do
        "pdf.fonttype": 42,
        "font.family": style.family,
        "font.size": style.font,
        "mathtext.fontset": "stix" if style.family.startswith("STIX") else "dejavusans",
        "axes.titlesize": style.font,
        "axes.titlelocation": "left",
        "axes.titlecolor": ink,
        "axes.labelcolor": muted,
        "axes.edgecolor": muted,
        "axes.linewidth": 0.6,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.color": grid,
        "grid.linewidth": 0.6,
        "xtick.color": muted,
        "ytick.color": muted,
        "xtick.labelsize": 0.92 * style.font,
        "ytick.labelsize": 0.92 * style.font,
        "text.color": ink,
        "lines.markersize": 0.42 * style.font,
        "legend.frameon": False,
        "legend.fontsize": style.font,
        "legend.handlelength": HANDLE,
        "legend.columnspacing": 1.5,
        "figure.facecolor": "none",
        "axes.facecolor": "none",
    }
    with _TURN, matplotlib.rc_context(settings):
        yield


def log(axis: Axes, *sides: str) -> None:
    """Logarithmic sides with few ticks, as 10⁻³; for call after everything is drawn."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    def tick(value: float, digits: int) -> str:  # over less than a decade it may need more than one digit: 2.5
        return power(value) if np.isclose(value, float(f"{value:.0e}"), rtol=1e-6) else short(value, digits)

    axis.set(**{f"{side}scale": "log" for side in sides})
    for side in sides:
        low, high = getattr(axis, f"get_{side}lim")()
        decades = np.log10(high) - np.log10(low)
        chosen = getattr(axis, f"{side}axis")
        chosen.set_major_locator(LogLocator(numticks=6, subs=(1.0,) if decades > 2 else (1.0, 2.0, 5.0)))
        visible = [value for value in chosen.get_majorticklocs() if low <= value <= high]
        # as many digits as distinguish the labels between the ends: 0.185 and 0.19
        digits = next((d for d in range(2, 8) if len({tick(value, d) for value in visible}) == len(visible)), 2)
        chosen.set_major_formatter(FuncFormatter(lambda value, _, digits=digits: lettered(tick(value, digits))))
        chosen.set_minor_formatter(NullFormatter())
        if decades > 6:
            chosen.set_minor_locator(NullLocator())


def lettered(text: str) -> str:
    """The text as the medium at hand can set it: as mathematics, but on a page."""
    import matplotlib

    return mathematics(text) if matplotlib.rcParams["axes.formatter.use_mathtext"] else text


def power(value: float) -> str:
    """10⁻³, 2·10⁻³, or 0.5: a positive number of one digit, such as a tick of a logarithmic side."""
    mantissa, exponent = f"{value:.0e}".split("e")
    if -1 <= int(exponent) <= 2:
        return f"{value:.0f}" if value >= 1 else f"{value:.1f}"
    ten = "10" + str(int(exponent)).translate(SUPERSCRIPTS)
    return ten if mantissa == "1" else f"{mantissa}·{ten}"


def short(value: float, digits: int = 2) -> str:
    """A number as people write it, with so many digits: 0.018, 9.2·10⁻⁸, 12,300, and ∞ where it is not finite."""
    if not np.isfinite(value):
        return "∞"
    if value == 0 or 0.01 <= abs(value) < 10**digits - 0.5:
        return f"{value:.{digits}g}"
    if 1 <= abs(value) < 1e6:
        return f"{value:,.0f}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPTS)}"
