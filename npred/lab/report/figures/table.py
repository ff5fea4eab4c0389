"""Tables as data: for a page (its template asks for rows and texts), a terminal, Markdown, CSV and LaTeX (booktabs)."""

import csv
import io
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from npred.lab.report.figures.style import short
from npred.lab.report.terminal.console import columns
from npred.plants.notation import PLAIN, RAISED, SUBSCRIPT, plain

LATEX = r"""% needs \usepackage{booktabs}
\begin{tabular}{@alignment}
\toprule
@heads \\
\midrule
@lines
\bottomrule
\end{tabular}
"""
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
        """A value for people; a number that is not finite as ∞, and None, where there is no value, as –."""
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

    @property
    def texts(self) -> list[list[str]]:
        """The cells of each row for people."""
        return [[column.text(value) for column, value in zip(self.columns, row, strict=True)] for row in self.rows]

    def terminal(self, width: int | None = None) -> str:
        """Aligned columns, folded to a width if there is one."""
        numbers = [plain(column.head) for column in self.columns if column.numeric]
        cells = [[plain(text) for text in row] for row in self.texts]
        return columns([plain(column.head) for column in self.columns], cells, width, numbers=numbers)

    def markdown(self) -> str:
        rows = [[column.head for column in self.columns], *self.texts]
        head, *others = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
        rule = "".join("|---:" if column.numeric else "|---" for column in self.columns) + "|"
        return "\n".join([head, rule, *others])

    def csv(self) -> str:
        """Headings and values, numbers with all their digits."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow([plain(column.head) for column in self.columns])
        for row in self.rows:
            writer.writerow(["" if v is None else plain(v) if isinstance(v, str) else v for v in row])
        return buffer.getvalue()

    def latex(self) -> str:
        """A booktabs table: words to the left, numbers to the right."""
        text = LATEX.replace("@alignment", "".join("r" if column.numeric else "l" for column in self.columns))
        text = text.replace("@heads", " & ".join(_latex(column.head) for column in self.columns))
        return text.replace("@lines", "\n".join(" & ".join(map(_latex_cell, row)) + r" \\" for row in self.texts))


def _latex_cell(text: str) -> str:
    if power := re.fullmatch("(.*)·10([⁻⁰-⁹¹²³]+)", text):
        return rf"${power[1]} \cdot 10^{{{power[2].translate(PLAIN)}}}$"
    return "---" if text == "–" else _latex(text)


def _latex(text: str) -> str:
    """The text for LaTeX; letters that `_{…}` lowers are set upright."""

    def greek(letter: re.Match[str]) -> str:
        name = unicodedata.name(letter[0]).split()[-1].lower()  # Unicode's name of a letter ends in its command
        return rf"$\{name if letter[0].islower() else name.capitalize()}$"

    parts = SUBSCRIPT.split(text)  # text, subscript, text, …
    for place, part in enumerate(parts):
        for symbol, command in SYMBOLS.items():
            part = part.replace(symbol, command)
        part = RAISED.sub(lambda raised: f"$^{{{raised[0].translate(PLAIN)}}}$", part)
        part = re.sub("[Α-Ωα-ω]", greek, part)
        parts[place] = rf"$_{{\textrm{{{part}}}}}$" if place % 2 else part
    return "".join(parts)
