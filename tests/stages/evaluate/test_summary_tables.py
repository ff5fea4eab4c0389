"""An evaluation for people: 80 columns by default, all of it on request."""

import pytest

from npred.stages.evaluate import summary_tables

ERRORS = {"mse": 1.2e-7, "eps_sup": 0.0184, "eps_kappa": 3.4e-3}
KINDS = {"nominal": ERRORS, "exploring": ERRORS}
RADIUS = {"median": 9e-15, "worst": 5.2e-5, "predicted": None, "converged": 0.98, "cases": 50}
ROW = {**ERRORS, "fresh": ERRORS, "kinds": KINDS, "in_loop": 2.5e-4, "radius": RADIUS,
       "settle_ratio": 1.02, "map": {"share": 0.96}, "figure1": {"radius": 0.0, "D_hat_end": None}}  # fmt: skip
EXACT = ROW | dict.fromkeys(ERRORS, 0.0)
RESULT = {
    "plant": "activator_repressor", "held_out": 12345, "fresh": 2000, "kinds": {"nominal": 12345, "exploring": 100},
    "models": {"numerical": EXACT, "no_adaptation": EXACT, "deeponet@150": ROW, "deeponet": ROW, "fno": ROW},
}  # fmt: skip


def test_the_table_says_who_errs_how_much_and_whose_loops_converge():
    numerical, _, _, network, _ = summary_tables.table(RESULT).splitlines()[1:]
    assert numerical.split() == ["numerical", "–", "5.2·10⁻⁵", "49", "of", "50"]
    assert network.split() == ["DeepONet", "0.018", "5.2·10⁻⁵", "49", "of", "50"]


def test_times_are_in_it_where_they_are_given():
    rows = summary_tables.table(RESULT, None, {"numerical": 1.25, "fno": 1234.5}).splitlines()
    assert rows[0].endswith("µs a call")
    assert [row.split()[-1] for row in rows[1:]] == ["1.2", "–", "–", "–", "1234.5"]


@pytest.mark.parametrize("width", [80, None])
def test_it_fits_80_columns(width: int | None):
    head, table = summary_tables.summary(RESULT, width).split("\n\n")
    assert "12345 held-out samples (nominal)" in head  # prose: `Console.out` folds it
    for text in (table, summary_tables.table(RESULT, width, {"numerical": 1e6})):
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
