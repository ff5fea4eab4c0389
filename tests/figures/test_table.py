"""Tables for people, as CSV and as LaTeX."""

import csv
import io
import math

import pytest
import result_samples
from result_samples import timing

from npred import plants
from npred.figures.style import power, short
from npred.figures.table import Column, Table
from npred.results import Evaluated
from npred.stages.report import tables

ERRORS = Table(
    "errors", "Errors",
    [Column("predictor", ["rk4_fast", "FNO"]), Column("ε sup", [9.234e-8, math.inf], digits=2),
     Column("kept", [1.0, None], ".0%")],
)  # fmt: skip


def shown(table: Table) -> list[list[str]]:
    return [[column.text(value) for column, value in zip(table.columns, row, strict=True)] for row in table.rows]


def test_people_read_few_digits_and_programs_all():
    assert shown(ERRORS) == [
        ["rk4_fast", "9.2·10⁻⁸", "100%"],
        ["FNO", "∞", "–"],
    ]
    assert list(csv.reader(io.StringIO(ERRORS.csv()))) == [
        ["predictor", "ε sup", "kept"], ["rk4_fast", "9.234e-08", "1.0"], ["FNO", "inf", ""],
    ]  # fmt: skip


def test_latex_has_commands_for_greek_letters():
    table = Table("t", "T", [Column("θ", ["ε of κ"]), Column("Ω_1", ["µ"])])
    heads, row = (line for line in table.latex().splitlines() if "&" in line)
    assert (heads, row) == (r"$\theta$ & $\Omega$\_1 \\", r"$\varepsilon$ of $\kappa$ & \textmu  \\")


def test_latex_escapes_words_and_sets_powers():
    lines = ERRORS.latex().splitlines()
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
    table = Table("t", "T", [Column("ε_{κ} (s⁻¹)", ["T_{out} {x}"]), Column("°C", ["a~b^2"])])
    heads, row = (line for line in table.latex().splitlines() if "&" in line)
    assert heads == r"$\varepsilon$$_{\textrm{$\kappa$}}$ (s$^{-1}$) & $^\circ$C \\"
    assert row == r"T$_{\textrm{out}}$ \{x\} & a\textasciitilde{}b\^{}2 \\"
    assert table.csv() == "ε_κ (s⁻¹),°C\nT_out {x},a~b^2\n"


def test_the_table_of_the_paper_has_a_line_a_predictor_and_a_pair_of_columns_a_dx():
    rows = [timing("euler_python", "python", 0.1, 60.0, eps_sup=1.1), timing("rk4", us=1.25, eps_sup=3.8e-4),
            timing("rk4", dx=0.01, us=4200.0, eps_sup=None)]  # fmt: skip
    table = tables.by_dx([*rows, timing("rk4", batch=1024), timing("rk4", matches="front")])
    assert shown(table) == [
        ["Euler, interpreted", "60", "1.1", "–", "–"],
        ["RK4", "1.25", "3.8·10⁻⁴", "4,200", "∞"],
    ]


def test_a_gpu_row_says_whether_copies_are_in_it():
    row = timing("fno", "torch", device="cuda", copies=True)
    assert "FNO, torch on cuda, with copies" in tables.by_dx([row]).csv()


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1.0, "1"), (0.018, "0.018"), (-3.25, "-3.2"), (99.6, "100"), (0.00999, "1.0·10⁻²"), (123.4, "123"),
     (12345.6, "12,346"), (2.5e7, "2.5·10⁷"), (9.23e-8, "9.2·10⁻⁸"), (9.99e-8, "1.0·10⁻⁷"), (math.inf, "∞")],
)  # fmt: skip
def test_numbers_as_people_write_them(value, text):
    assert short(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(1e-3, "10⁻³"), (0.5, "0.5"), (20.0, "20"), (2e-5, "2·10⁻⁵"), (1e6, "10⁶")]
)
def test_ticks_as_people_write_them(value, text):
    assert power(value) == text


def test_the_table_of_scenarios_has_a_line_a_scenario_and_predictor():
    does = {"radius": {"median": 0.1, "worst": None, "converged": 0.5, "cases": 4}, "settle_time": 3.0, "lost": 1,
            "D_error": None}  # fmt: skip
    one = {"name": "noise 3 %", "models": {"numerical": does | {"D_error": 0.02}, "fno": does}}
    evaluated = Evaluated.of(result_samples.evaluated({"numerical": result_samples.SCORES}) | {"scenarios": [one]}, "t")
    plant = plants.resolve("scalar")
    table = tables.scenarios(plant, evaluated)
    assert table is not None and table.columns[-1].head == "|D̂ − D| (s)"
    assert shown(table) == [
        ["noise 3 %", "numerical", "0.1", "∞", "2", "1", "3", "0.02"],
        ["noise 3 %", "FNO", "0.1", "∞", "2", "1", "3", "–"],
    ]
    assert tables.scenarios(plant, result_samples.evaluation("numerical")) is None
