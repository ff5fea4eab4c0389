"""A benchmark for people: 80 columns by default, all of it on request; and the time of each predictor's call."""

from result_samples import BENCHED, CROSSOVER, timing

from npred.lab.config.results import NUMERICAL, Benched, PredictorId
from npred.lab.config.results.bench import Crossover
from npred.lab.stages.bench import bench

ROWS = [
    timing("published", "python", 0.001, 14321.0),
    timing("rk4", "compiled", 0.01, 1.0),
    timing("rk4", "compiled", 0.001, 9.5),
    timing("deeponet", "torch", 0.001, 864.0),
    timing("deeponet", "fused", 0.001, 6.9),
    timing("deeponet", "torch", 0.001, 90.0, device="cuda:0", copies=False, batch=1024),
    timing("euler", "compiled", 0.125, 0.7, matches="deeponet"),
    timing("euler", "compiled", 0.25, 0.5, matches="front", eps_sup=None),
]
SENTENCE = bench.network_pays(Crossover.of(CROSSOVER, "a test"))
RESULT = Benched.of(BENCHED | {"rows": ROWS, "crossover": [CROSSOVER | {"sentence": SENTENCE}]}, "a test")


def test_the_summary_fits_80_columns_and_leaves_out_what_only_a_figure_needs():
    lines = bench.summary(RESULT, 80).splitlines()
    assert max(map(len, lines[:-2])) <= 80 and "…" not in "".join(lines)
    assert lines[2].split() == ["predictor", "dx", "batch", "median", "µs", "ε", "sup", "ε", "median"]
    assert len([line for line in lines if line.startswith("Euler")]) == 1
    assert lines[-2].startswith("For arm at ε = 0.02 ") and lines[-1] == "The machine stops."


def test_the_details_have_every_row_with_its_tails_and_ratios():
    text = bench.details(RESULT)
    assert "99.9 %" in text and "× O(nx²) sums" in text and "published" not in text
    assert "torch on cuda:0, without copies" in text
    assert len(text.splitlines()) == 3 + len(ROWS) + 3


def test_a_call_is_the_fastest_runtimes_at_the_finest_grid():
    assert bench.fastest(RESULT, "rk4") == {NUMERICAL: 9.5, PredictorId("deeponet"): 6.9}
    assert bench.fastest(Benched.of(BENCHED, "a test"), "rk4") == {}
