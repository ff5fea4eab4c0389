"""Tables as data: for a page, as CSV with all digits, and as LaTeX (booktabs)."""

import csv
import io
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from npred.figures.notation import PLAIN, RAISED, SUBSCRIPT, plain
from npred.figures.style import short

LATEX = r"""% needs \usepackage{booktabs}
\begin{tabular}{@alignment}
\toprule
@heads \\
\midrule
@lines
\bottomrule
\end{tabular}
"""
GREEK = re.compile("[Α-Ωα-ω]")
SYMBOLS = {
    "{": r"\{", "}": r"\}", "^": r"\^{}", "~": r"\textasciitilde{}",  # first, for others bring them
    "%": r"\%", "_": r"\_", "&": r"\&", "#": r"\#", "µ": r"\textmu ", "ε": r"$\varepsilon$", "κ": r"$\kappa$",
    "D̂": r"$\hat{D}$", "−": "$-$", "×": r"$\times$", "∞": r"$\infty$", "°": r"$^\circ$", "·": r"$\cdot$",
    "ü": r'\"u', "|": "$|$",
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A heading, a value per row, and how a number is written: a format, or so many `digits`.

    `about` says below the table of a page what the heading cannot.
    """

    head: str
    values: Sequence[Any]
    form: str = ""
    digits: int = 0
    about: str = ""

    @property
    def numeric(self) -> bool:
        """True if its values are numbers."""
        return bool(self.form or self.digits)

    def text(self, value: Any) -> str:
        """A value for people; a number that is not finite as ∞, and what there is none of, None, as –."""
        if value is None:
            return "–"
        if isinstance(value, float) and not isfinite(value):
            return "∞"
        text = short(value, self.digits) if self.digits else format(value, self.form)
        return text.replace("-", "−") if self.numeric else text


@dataclass(frozen=True)
class Table:
    """A table: `name` is its file's."""

    name: str
    title: str
    columns: Sequence[Column]

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """A value per column."""
        return list(zip(*(column.values for column in self.columns), strict=True))

    def csv(self) -> str:
        """Headings and values, numbers with all their digits."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow([plain(column.head) for column in self.columns])
        writer.writerows([_written(value) for value in row] for row in self.rows)
        return buffer.getvalue()

    def latex(self) -> str:
        """A booktabs table: words to the left, numbers to the right."""
        lines = [" & ".join(map(_cell, self.columns, row)) + r" \\" for row in self.rows]
        text = LATEX.replace("@alignment", "".join("r" if column.numeric else "l" for column in self.columns))
        text = text.replace("@heads", " & ".join(_plain(column.head) for column in self.columns))
        return text.replace("@lines", "\n".join(lines))


def _written(value: Any) -> Any:
    return "" if value is None else plain(value) if isinstance(value, str) else value


def _cell(column: Column, value: Any) -> str:
    text = column.text(value)
    if power := re.fullmatch("(.*)·10([⁻⁰-⁹¹²³]+)", text):
        return rf"${power[1]} \cdot 10^{{{power[2].translate(PLAIN)}}}$"
    return {"–": "---"}.get(text, _plain(text))


def _plain(text: str) -> str:
    """The text for LaTeX; what `_{…}` lowers is set upright."""
    parts = SUBSCRIPT.split(text)  # text, subscript, text, …
    return "".join(rf"$_{{\textrm{{{_signs(part)}}}}}$" if k % 2 else _signs(part) for k, part in enumerate(parts))


def _signs(text: str) -> str:
    for symbol, command in SYMBOLS.items():
        text = text.replace(symbol, command)
    text = RAISED.sub(lambda part: f"$^{{{part[0].translate(PLAIN)}}}$", text)
    return GREEK.sub(_greek, text)


def _greek(letter: re.Match[str]) -> str:
    """The command of a letter, which Unicode's name of it ends in."""
    name = unicodedata.name(letter[0]).split()[-1].lower()
    return rf"$\{name if letter[0].islower() else name.capitalize()}$"
