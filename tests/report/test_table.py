"""Tables for people, as CSV and as LaTeX."""

import csv
import io
import math
from typing import Any

import pytest
import result_samples
from result_samples import timing

from npred import plants
from npred.lab.config.results import Certified, Evaluated, Trained
from npred.lab.config.results.base import Result
from npred.lab.config.results.evaluate import Behaviour, Certificate
from npred.lab.report.figures.style import power, short
from npred.lab.report.figures.table import Column, Table
from npred.lab.stages.report import tables

ERRORS = Table(
    "errors", "Errors",
    [Column("predictor", ["rk4_fast", "FNO"]), Column("ε sup", [9.234e-8, math.inf], digits=2),
     Column("kept", [1.0, None], ".0%")],
)  # fmt: skip


def test_people_read_few_digits_and_programs_all():
    assert ERRORS.texts == [["rk4_fast", "9.2·10⁻⁸", "100%"], ["FNO", "∞", "–"]]
    assert list(csv.reader(io.StringIO(ERRORS.csv()))) == [
        ["predictor", "ε sup", "kept"], ["rk4_fast", "9.234e-08", "1.0"], ["FNO", "inf", ""],
    ]  # fmt: skip


def test_a_terminal_gets_aligned_columns_and_markdown_bars():
    assert ERRORS.terminal().splitlines() == [
        "predictor     ε sup  kept", "rk4_fast   9.2·10⁻⁸  100%", "FNO               ∞     –",
    ]  # fmt: skip
    assert (
        Table("t", "T", [Column("a|b", ["x"]), Column("n", [1], "d")]).markdown()
        == "| a\\|b | n |\n|---|---:|\n| x | 1 |"
    )


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
    assert table.texts == [["Euler, interpreted", "60", "1.1", "–", "–"], ["RK4", "1.25", "3.8·10⁻⁴", "4,200", "∞"]]


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
    does = {"radius": {"median": 0.1, "worst": None, "converged": 0.5, "cases": 4}, "settle_time": 3.0, "far": 1,
            "D_error": None}  # fmt: skip
    one = {"name": "noise 3 %", "models": {"numerical": does | {"D_error": 0.02}, "fno": does}}
    evaluated = Evaluated.of(result_samples.evaluated({"numerical": result_samples.SCORES}) | {"scenarios": [one]}, "t")
    plant = plants.resolve("scalar")
    table = tables.scenarios(plant, evaluated)
    assert table is not None and table.columns[-1].head == "|D̂ − D| (s)"
    assert table.texts == [
        ["noise 3 %", "numerical", "0.1", "∞", "2", "1", "3", "0.02"],
        ["noise 3 %", "FNO", "0.1", "∞", "2", "1", "3", "–"],
    ]
    assert tables.scenarios(plant, result_samples.evaluation("numerical")) is None


def last_row(table: Table | None) -> dict[str, object]:
    """The cells of the last row by the heads of their columns."""
    assert table is not None
    return {column.head: column.values[-1] for column in table.columns}


def numbered(kind: type[Result], first: int = 1, **given: object) -> dict[str, Any]:
    """A result of which each number is another one."""
    numbers = {name: first + k for k, name in enumerate(kind.model_fields)}
    return numbers | given


def test_each_number_of_an_evaluation_is_below_the_head_that_names_it():
    errors = {"mse": 1.0, "eps_sup": 2.0, "eps_kappa": 3.0, "rel_l2": 4.0}
    fresh, explored = ({name: base + value for name, value in errors.items()} for base in (10.0, 20.0))
    kept = {"converged": [[True, True, False], [True, False, False]]}
    own = {"converged": [[True, False, True], [True, False, False]]}
    scores = result_samples.SCORES | errors | {
        "kinds": {"nominal": errors | {"above": 0.0}, "exploring": explored | {"above": 0.7}}, "fresh": fresh,
        "radius": {"median": 31.0, "worst": 32.0, "converged": 0.75, "cases": 8, "predicted": 33.0},
        "settle_ratio": 34.0, "in_loop": 35.0, "fallback": 0.36, "map": result_samples.MAP | own,
        "figure1": {"X_end": [0.0], "D_hat_end": 37.0, "radius": 38.0, "settle_time": 39.0},
    }  # fmt: skip
    numerical = result_samples.SCORES | {"map": result_samples.MAP | kept}
    sample = result_samples.evaluated({"numerical": numerical, "fno": scores})
    sample["coverage"] = {"x1": {"data": [41.0, 42.0], "outside": {"fno": 0.43}}}
    evaluated = Evaluated.of(sample, "a test")
    named = {"mean square": 1.0, "ε sup": 2.0, "ε_{κ}": 3.0, "relative L²": 4.0}
    assert last_row(tables.accuracy(evaluated)) == {
        "predictor": "FNO", **named, "mean square, fresh rollouts": 11.0, "ε sup, fresh rollouts": 12.0,
    }  # fmt: skip
    assert last_row(tables.kinds(evaluated)) == {
        "predictor": "FNO", "held out": "exploring rollouts", "samples": 100,
        **{head: 20.0 + value for head, value in named.items()}, "above ε sup of nominal rollouts": 0.7,
    }  # fmt: skip
    assert last_row(tables.loops(evaluated)) == {
        "predictor": "FNO", "radius, median": 31.0, "worst": 32.0, "from ε_{κ}": 33.0, "converged of 50": 6,
        "settles ×": 34.0, "map, of 3": 2, "radius, loop shown": 38.0, "D̂ at its end": 37.0,
        "sup |P(1, t) − X(t + D)|": 35.0, "fallback": 0.36,
    }  # fmt: skip
    settles = next(column for column in tables.loops(evaluated).columns if column.head == "settles ×")
    assert "over the numerical predictor's" in settles.about
    outside = last_row(tables.outside(plants.resolve("activator_repressor"), evaluated.coverage))
    assert list(outside.values())[1:] == [41.0, 42.0, 0.43]
    assert list(outside)[1:] == ["data from", "to", "outside, FNO"]


def test_each_number_of_a_scenario_is_below_the_head_that_names_it():
    radius = {"median": 1.0, "worst": 2.0, "converged": 0.75, "cases": 4}
    does = {"radius": radius, "settle_time": 4.0, "far": 5, "D_error": 6.0, "fallback": 0.7}
    one = {"scenarios": [{"name": "noise", "models": {"fno": does}}]}
    sample = result_samples.evaluated({"numerical": result_samples.SCORES}) | one
    assert last_row(tables.scenarios(plants.resolve("scalar"), Evaluated.of(sample, "a test"))) == {
        "scenario": "noise", "predictor": "FNO", "radius, median": 1.0, "worst": 2.0, "converged of 4": 3,
        "ends far": 5, "settles after (s)": 4.0, "|D̂ − D| (s)": 6.0, "fallback": 0.7,
    }  # fmt: skip


def test_a_result_of_an_earlier_version_is_read():
    """Loops that end far away were called `diverged`, whether they were bounded or not."""
    radius = {"median": 1.0, "worst": 2.0, "converged": 0.75, "cases": 4}
    earlier = {"radius": radius, "settle_time": 4.0, "diverged": 5, "D_error": 6.0}
    read = Behaviour.of(earlier, "a test")
    assert read.far == 5 and read.json_object()["far"] == 5 and "diverged" not in read.json_object()


CERTIFICATE = numbered(Certificate, bound=[51.0, 52.0, 53.0], ratio=[])
CERTIFIED = {"ε_{κ} of all rollouts": "eps_kappa", "median": "median", "adversary": "adversarial",
             "calls above the tolerance": "above", "unnoticed": "unnoticed", "blind spots": "blind",
             "ends far": "far", "guarded": "far_guarded", "fallback": "fallback",
             "bounded": "bounded"}  # fmt: skip


def test_each_number_of_a_certificate_is_below_the_head_that_names_it():
    sample = {"plant": "arm", "loops": 9, "far_numerical": 8, "models": {"fno": CERTIFICATE}}
    table = tables.certified(Certified.of(sample, "a test"))
    expected = {head: CERTIFICATE[key] for head, key in CERTIFIED.items()}
    assert last_row(table) == {"network": "FNO", "bound / error": 52.0} | expected
    assert (
        table is not None
        and table.title == f"Certificate, with {CERTIFICATE['rollouts']} rollouts of 5 samples each and 9 loops"
    )


def test_each_number_of_a_training_is_below_the_head_that_names_it():
    trained = numbered(Trained, model="fno")
    assert last_row(tables.training({"fno": Trained.of(trained, "a test")})) == {
        "network": "FNO", **{name: trained[name] for name in ("parameters", "samples", "epochs")},
        "last loss": trained["loss"],
    }  # fmt: skip


def test_each_time_is_below_the_head_that_names_it():
    times = {"median_us": 1.0, "p95_us": 2.0, "p999_us": 3.0, "max_us": 4.0, "eps_sup": 5.0, "eps_median": 6.0}
    row = timing("fno", "fused", dx=0.05, batch=7, speedup_published=8.0, speedup_compiled=9.0, **times)
    assert last_row(tables.speed([timing("rk4", matches="front"), row])) == {
        "predictor": "FNO, fused", "dx": 0.05, "batch": 7, "median µs": 1.0, "95 %": 2.0, "99.9 %": 3.0, "max": 4.0,
        "ε sup": 5.0, "ε median": 6.0, "× O(nx²) sums": 8.0, "× Euler": 9.0,
    }  # fmt: skip
