"""The page of published experiments: rows as they are printed, distances from the numerical row, its sentences."""

import pytest

from npred_experiments import page
from npred_experiments.experiment import PredictionTime, Reproduced, ReproducedRow, TrainedForLoop


def row(predictor: str, published: float | None, measured: float | None, meant: float | None = 0.5) -> ReproducedRow:
    return ReproducedRow(
        predictor=predictor, metric="prediction", published=published, as_published=measured, as_meant=meant
    )


TRAINED = TrainedForLoop(
    network="fno", loop="as published", parameters=1234, samples=100, epochs=3, loss=0.1, mse=1e-6, eps_sup=0.02,
    seconds=41.4, ms=0.0042,
)  # fmt: skip
ROWS = [
    row("numerical", 0.028543, 0.0285430028),
    row("fno", 0.061734, 0.028643),
    row("deeponet", 0.058748, 0.0286),
    row("fno_gru", 0.268882, None, None),
    row("deeponet_gru", 0.156749, 0.4),
]
TIME = PredictionTime(predictor="fno", setting="Euler, 100 steps", published_ms=1.0627, ms=0.0042, error=0.02)
RESULT = Reproduced(name="unicycle_constant", rows=ROWS, trained=[TRAINED], times=[TIME])


def test_distances_are_shares_of_the_numerical_row_of_the_same_loop():
    fno, deeponet, lost, far = page.excesses([RESULT])
    assert fno.published == pytest.approx((0.061734 - 0.028543) / 0.0285430028)
    assert fno.measured == pytest.approx(0.028643 / 0.0285430028 - 1)
    assert deeponet.measured is not None and far.measured is not None
    assert deeponet.measured < 0.01 < far.measured
    assert lost.measured is None


def test_where_the_numerical_row_is_rounding_the_error_itself_counts():
    exact = Reproduced(name="manipulator", rows=[row("numerical", 0.0, 3.4e-8), row("fno", 0.00943, 0.001)], trained=[])
    (fno,) = page.excesses([exact])
    assert (fno.published, fno.measured) == pytest.approx((0.00943, 0.001), abs=1e-7)


def test_the_sentences_count_rows():
    numerical, networks, seconds = page.summary([RESULT])
    assert "Of 1 printed numbers" in numerical and "1 have the same digits" in numerical
    assert "Of 3 printed numbers" in networks and "in 2;" in networks
    assert "at most 41 s" in seconds


def test_the_page_and_the_markdown_have_the_printed_digits():
    html, markdown = page.page([RESULT]), page.markdown([RESULT])
    assert "| FNO | prediction | 0.061734 | 0.028643 | 0.500000 |" in markdown
    assert "| FNO + GRU | prediction | 0.268882 | – | – |" in markdown
    assert all(text in html and text not in markdown for text in ("1,234", "Euler, 100 steps", "0.0042"))
    assert all(text in html and text in markdown for text in ("0.061734", "0.028543", "DeepONet + GRU"))
    assert "Unicycle, constant delay" in html and "arXiv:2411.18964" in html
    assert "https:" not in html and "default-src 'none'" in html
    assert page.page([RESULT]) == html


def test_the_markdown_has_the_first_metric_that_is_printed_and_names_an_experiment_once():
    second = ROWS[0].model_copy(update={"metric": "tracking"})
    other = Reproduced(name="manipulator", rows=[row("numerical", 0.0, 3.4e-8), row("fno", None, 0.001), second])
    table = [line.split(" | ")[:2] for line in page.markdown([RESULT, other]).splitlines() if line.startswith("| ")]
    names = ["| experiment", "| `unicycle_constant`", "| ", "| ", "| ", "| ", "| `manipulator`"]
    assert [name for name, _ in table] == names and table[-1][1] == "numerical"


def test_a_page_without_networks_has_no_figure():
    numerical = Reproduced(name="unicycle_constant", rows=ROWS[:1], trained=[])
    assert "<figure" not in page.page([numerical])
    assert "<figure" in page.page([RESULT])
