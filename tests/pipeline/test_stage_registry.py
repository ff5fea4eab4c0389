"""Tables for people, as CSV and as LaTeX."""

import csv
import io

import pytest

from npred.figures.style import power, short
from npred.figures.table import Column, Grid
from npred.stages.report import tables

GRID = Grid(
    "errors", "Errors",
    [Column("predictor", "name"), Column("ε sup", "eps", digits=2), Column("kept", "kept", ".0%")],
    [{"name": "rk4_fast", "eps": 9.234e-8, "kept": 1.0}, {"name": "FNO", "eps": None, "kept": ""}],
)  # fmt: skip
ROW = {"runtime": "compiled", "batch": 1, "matches": None, "copies": None, "device": "cpu", "speedup_published": 2.0,
       "speedup_compiled": None, "p95_us": 2.0, "p999_us": 3.0, "max_us": 4.0}  # fmt: skip


def test_people_read_few_digits_and_programs_all():
    assert [[column.text(row[column.key]) for column in GRID.columns] for row in GRID.rows] == [
        ["rk4_fast", "9.2·10⁻⁸", "100%"],
        ["FNO", "∞", "–"],
    ]
    assert list(csv.reader(io.StringIO(GRID.csv()))) == [
        ["predictor", "ε sup", "kept"], ["rk4_fast", "9.234e-08", "1.0"], ["FNO", "inf", ""],
    ]  # fmt: skip


def test_latex_has_commands_for_greek_letters():
    table = Grid("t", "T", [Column("θ", "a"), Column("Ω_1", "b")], [{"a": "ε of κ", "b": "µ"}])
    heads, row = (line for line in table.latex().splitlines() if "&" in line)
    assert (heads, row) == (r"$\theta$ & $\Omega$\_1 \\", r"$\varepsilon$ of $\kappa$ & \textmu  \\")


def test_latex_escapes_words_and_sets_powers():
    lines = GRID.latex().splitlines()
    assert lines[1:] == [
        r"\begin{tabular}{lrr}",
        r"\toprule",
        r"predictor & $\varepsilon$ sup & kept \\",
        r"\midrule",
        r"rk4\_fast & $9.2 \cdot 10^{-8}$ & 100\% \\",
        r"FNO & $\infty$ & --- \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_subscripts_and_units_are_set_in_latex_and_plain_in_csv():
    table = Grid("t", "T", [Column("ε_{κ} (s⁻¹)", "a"), Column("°C", "b")], [{"a": "T_{out} {x}", "b": "a~b^2"}])
    heads, row = (line for line in table.latex().splitlines() if "&" in line)
    assert heads == r"$\varepsilon$$_{\textrm{$\kappa$}}$ (s$^{-1}$) & $^\circ$C \\"
    assert row == r"T$_{\textrm{out}}$ \{x\} & a\textasciitilde{}b\^{}2 \\"
    assert table.csv() == "ε_κ (s⁻¹),°C\nT_out {x},a~b^2\n"


def test_the_table_of_the_paper_has_a_line_a_predictor_and_a_pair_of_columns_a_dx():
    measured = [("euler_python", "python", 0.1, 60.0, 1.1), ("rk4", "compiled", 0.1, 1.25, 3.8e-4)]
    measured += [("rk4", "compiled", 0.01, 4200.0, None)]
    keys = ("predictor", "runtime", "dx", "median_us", "eps_sup")
    rows = [ROW | dict(zip(keys, values, strict=True)) for values in measured]
    table = tables.by_dx([*rows, rows[1] | {"batch": 1024}, rows[1] | {"matches": "front"}])
    assert [[column.text(row[column.key]) for column in table.columns] for row in table.rows] == [
        ["Euler, interpreted", "60", "1.1", "–", "–"],
        ["RK4", "1.25", "3.8·10⁻⁴", "4,200", "∞"],
    ]


def test_a_gpu_row_says_whether_copies_are_in_it():
    row = ROW | {"predictor": "fno", "runtime": "torch", "device": "cuda", "copies": True, "dx": 0.1, "median_us": 1.0}
    assert "FNO, torch on cuda, with copies" in tables.by_dx([row | {"eps_sup": 0.1}]).csv()


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1.0, "1"), (0.018, "0.018"), (-3.25, "-3.2"), (99.6, "100"), (0.00999, "1.0·10⁻²"), (123.4, "123"),
     (12345.6, "12,346"), (2.5e7, "2.5·10⁷"), (9.23e-8, "9.2·10⁻⁸"), (9.99e-8, "1.0·10⁻⁷"), (None, "∞")],
)  # fmt: skip
def test_numbers_as_people_write_them(value, text):
    assert short(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(1e-3, "10⁻³"), (0.5, "0.5"), (20.0, "20"), (2e-5, "2·10⁻⁵"), (1e6, "10⁶")]
)
def test_ticks_as_people_write_them(value, text):
    assert power(value) == text
