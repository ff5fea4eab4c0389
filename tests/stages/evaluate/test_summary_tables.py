"""An evaluation for people: 80 columns by default, all of it on request."""

import pytest
from result_samples import ERRORS, SCORES, evaluated, evaluation

from npred.lab.config.results import NUMERICAL, Evaluated, PredictorId
from npred.lab.stages.evaluate import evaluate
from npred.lab.stages.report import tables

EXACT = SCORES | dict.fromkeys(ERRORS, 0.0)
MODELS = {"numerical": EXACT, "no_adaptation": EXACT, "deeponet@150": SCORES, "deeponet": SCORES, "fno": SCORES}
RESULT = Evaluated.of(evaluated(MODELS), "a test")


def test_the_table_says_who_errs_how_much_and_whose_loops_converge():
    numerical, _, _, network, _ = tables.predictors(RESULT).terminal().splitlines()[1:]
    assert numerical.split() == ["numerical", "–", "5.2·10⁻⁵", "49", "of", "50"]
    assert network.split() == ["DeepONet", "0.018", "5.2·10⁻⁵", "49", "of", "50"]


def test_times_are_in_it_where_they_are_given():
    rows = tables.predictors(RESULT, {NUMERICAL: 1.25, PredictorId("fno"): 1234.5}).terminal().splitlines()
    assert rows[0].endswith("µs per call")
    assert [row.split()[-1] for row in rows[1:]] == ["1.2", "–", "–", "–", "1234.5"]


@pytest.mark.parametrize("width", [80, None])
def test_it_fits_80_columns(width: int | None):
    head, table = evaluate.summary(RESULT, width).split("\n\n")
    assert "12345 held-out samples (nominal)" in head  # prose: `Console.out` folds it
    for text in (table, tables.predictors(RESULT, {NUMERICAL: 1e6}).terminal(width)):
        assert max(map(len, text.splitlines())) <= 80 and "…" not in text


def cells(text: str, *heads: str) -> list[str]:
    """The cells of the last line of an aligned table whose right edge is that of their head."""
    head, *_, row = text.splitlines()
    return [row[: head.index(name) + len(name)].split()[-1] for name in heads]


def test_all_that_was_measured_is_in_the_details():
    _, accuracy, kinds, loops = evaluate.details(RESULT).split("\n\n")
    for text, words in (
        (accuracy, ("mean square", "ε sup", "ε_κ", "relative L²", "ε sup, fresh rollouts", "mean square, fresh")),
        (kinds, ("held out", "exploring rollouts", "ε sup")),
        (loops, ("sup |P(1, t) − X(t + D)|", "radius, median", "worst", "from ε_κ", "settles ×", "map, of 6",
                 "radius, loop shown", "D̂ at its end")),
    ):  # fmt: skip
        assert not [word for word in words if word not in text]
    _, head, *rows = loops.splitlines()
    assert len(rows) == 5
    assert cells("\n".join([head, *rows]), "settles ×", "map, of 6", "D̂ at its end") == ["1.02", "6", "∞"]


def test_each_radius_is_below_its_head():
    radius = {"median": 0.1, "worst": 0.2, "converged": 0.5, "cases": 4, "predicted": 0.3}
    loops = tables.loops(evaluation("numerical", "fno", radius=radius)).terminal()
    assert cells(loops, "radius, median", "worst", "from ε_κ", "converged of 4") == ["0.1", "0.2", "0.3", "2"]


def test_limits_have_columns_where_the_plant_declares_any():
    kept = {"least": 0.0123, "filtered": 0.25, "unkept": 3}
    heads = ("least h", "filtered", "steps without a plan")
    result = evaluation("numerical", limits=kept)
    assert tables.predictors(result).terminal().splitlines()[0].endswith("least h")
    loops = evaluate.details(result).split("\n\n")[-1].split("\n", 1)[1]
    assert cells(loops, *heads) == ["0.0123", "25.00%", "3"]
    free = {"least": None, "filtered": None, "unkept": None}  # a loop that is lost, without a filter
    assert "overflow" in tables.predictors(evaluation("numerical", limits=free)).terminal()
    assert not [head for head in heads if head in evaluate.details(RESULT)]
