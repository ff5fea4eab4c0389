"""An evaluation for people: 80 columns by default, all of it on request."""

import pytest
from result_samples import ERRORS, SCORES, evaluated, evaluation

from npred.results import NUMERICAL, Evaluated, PredictorId
from npred.stages.evaluate import summary_tables

EXACT = SCORES | dict.fromkeys(ERRORS, 0.0)
MODELS = {"numerical": EXACT, "no_adaptation": EXACT, "deeponet@150": SCORES, "deeponet": SCORES, "fno": SCORES}
RESULT = Evaluated.of(evaluated(MODELS), "a test")


def test_the_table_says_who_errs_how_much_and_whose_loops_converge():
    numerical, _, _, network, _ = summary_tables.table(RESULT).splitlines()[1:]
    assert numerical.split() == ["numerical", "–", "5.2·10⁻⁵", "49", "of", "50"]
    assert network.split() == ["DeepONet", "0.018", "5.2·10⁻⁵", "49", "of", "50"]


def test_times_are_in_it_where_they_are_given():
    rows = summary_tables.table(RESULT, None, {NUMERICAL: 1.25, PredictorId("fno"): 1234.5}).splitlines()
    assert rows[0].endswith("µs per call")
    assert [row.split()[-1] for row in rows[1:]] == ["1.2", "–", "–", "–", "1234.5"]


@pytest.mark.parametrize("width", [80, None])
def test_it_fits_80_columns(width: int | None):
    head, table = summary_tables.summary(RESULT, width).split("\n\n")
    assert "12345 held-out samples (nominal)" in head  # prose: `Console.out` folds it
    for text in (table, summary_tables.table(RESULT, width, {NUMERICAL: 1e6})):
        assert max(map(len, text.splitlines())) <= 80 and "…" not in text


def test_all_that_was_measured_is_in_the_details():
    head, *rows = summary_tables.details(RESULT).splitlines()[2:]
    for words in (
        "MSE",
        "ε κ",
        "fresh: ε sup",
        "exploring: ε sup",
        "in the loop",
        "radius",
        "worst",
        "from ε κ",
        "settles",
        "map",
        "Fig. 1",
        "D̂",
    ):
        assert words in head
    assert len(rows) == 5 and rows[-1].endswith("∞") and "1.02 ×" in rows[-1] and "96%" in rows[-1]


def test_each_radius_is_below_its_head():
    radius = {"median": 0.1, "worst": 0.2, "converged": 0.5, "cases": 4, "predicted": 0.3}
    head, _, row = summary_tables.details(evaluation("numerical", "fno", radius=radius)).splitlines()[-3:]
    columns = ("radius", "worst", "from ε κ")
    cells = [row[head.index(name) :].split()[0] for name in columns]
    assert dict(zip(columns, cells, strict=True)) == {"radius": "1.0e-01", "worst": "2.0e-01", "from ε κ": "3.0e-01"}


def test_limits_have_columns_where_the_plant_declares_any():
    kept = {"least": 0.0123, "filtered": 0.25, "unkept": 3}
    result = evaluation("numerical", limits=kept)
    assert summary_tables.table(result).splitlines()[0].endswith("least h")
    head, row = summary_tables.details(result).splitlines()[-2:]
    cells = [row[head.index(name) :].split()[0] for name in summary_tables.LIMITS]
    assert cells == ["0.0123", "25.00%", "3"]
    free = {"least": None, "filtered": None, "unkept": None}  # a loop that is lost, without a filter
    assert "lost" in summary_tables.table(evaluation("numerical", limits=free))
    assert not set(summary_tables.LIMITS) & set(summary_tables.details(RESULT).splitlines()[2].split("  "))
