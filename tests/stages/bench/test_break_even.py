"""When a network pays: arithmetic on made-up latencies, and grids of equal accuracy."""

from types import SimpleNamespace

import pytest
from jobs import job
from result_samples import CROSSOVER, timing

from npred import plants
from npred.lab.config.results.bench import Crossover
from npred.lab.stages.bench import bench, candidates
from npred.lab.stages.bench.candidates import Candidate, ErrorSizes
from npred.prediction.methods import RK4, Euler

PLANT = plants.resolve("scalar")


def entry(name, runtime, nx, run=None, matches=None):
    return Candidate(name, runtime, nx, 1, run or RK4(PLANT, nx), matches)


def test_break_even_is_where_both_take_as_long(tmp_path, monkeypatch):
    """1 us a call and 0.1 us an evaluation: 10 steps of RK4 take 5 us, so a network of 9 us pays from 0.2 us on."""
    monkeypatch.setattr(bench, "call", lambda reference, run: run)
    networks = {"network": 9.0, "slow": 11.0}

    def sample(calls, count, seconds):
        return {name: networks.get(run) or 1.0 + 0.1 * run.evaluations() * (run.nx - 1) for name, run in calls.items()}

    monkeypatch.setattr(bench.timing, "sample", sample)
    monkeypatch.setattr(bench.timing, "quantiles", lambda us: {"median_us": us})
    timed = [
        (entry("deeponet", "torch", 11, "slow"), timing("any", us=11.0, eps_sup=0.02)),
        (entry("deeponet", "fused", 11, "network"), timing("any", us=9.0, eps_sup=0.02)),
        (entry("rk4", "compiled", 11, matches="deeponet"), timing("any", us=5.0, eps_sup=0.01)),
        (entry("euler", "compiled", 101, Euler(PLANT, 101), "deeponet"), timing("any", us=11.0, eps_sup=0.01)),
        (entry("rk4", "compiled", 5, matches="front"), timing("any", us=2.6, eps_sup=0.2)),
    ]
    errors = ErrorSizes(0.01, 0.005)
    reference = SimpleNamespace(P=[[-4.0, 2.0]], plant=PLANT, of_method=lambda run, nx: errors)
    (found,) = bench.crossovers(job(tmp_path, "bench", bench={"dx": [0.1]}), timed, reference)
    assert (found.predictor, found.runtime, found.best, found.best_steps) == ("deeponet", "fused", "rk4", 10)
    assert [row.predictor for row in found.numerical] == ["rk4", "euler"]
    assert found.eps_relative == pytest.approx(0.005) and found.network_speedup == pytest.approx(5 / 9)
    assert found.f_ns == pytest.approx(100) and found.best_us == pytest.approx(5.0)
    assert found.pays_from_ns == pytest.approx(200)


@pytest.mark.parametrize(
    ("speedup", "words"),
    [
        (
            0.5,
            "is RK4 on 10 steps, 2.0 times as fast as the FNO (fused, dx = 0.005): the network takes 10.0 µs, RK4 on",
        ),
        (4.0, "is the FNO (fused, dx = 0.005), 4.0 times as fast as RK4 on 10 steps: the network takes 10.0 µs, RK4"),
    ],
)
def test_sentence(speedup, words):
    found = Crossover.of(CROSSOVER | {"network_speedup": speedup}, "a test")
    text = bench.network_pays(found)
    once = bench.network_pays(found.model_copy(update={"best_steps": 1, "network_speedup": 4.0}))
    assert "the network takes 10.0 µs, RK4 on 10 steps 5.0 µs, Euler on 99 steps 9.0 µs. By the median" in text
    assert "3.0·10⁻³, RK4 on 7 steps is as accurate as the network in 4.0 µs, 2.5 times as fast." in text
    assert words in text and text.endswith("if one evaluation of f takes at least 200 ns; here it takes 80 ns.")
    assert "on 1 step:" in once
    assert bench.network_pays(found.model_copy(update={"pays_from_ns": 0.0})).endswith(
        "A network pays however cheap f is; here it takes 80 ns."
    )


@pytest.mark.parametrize(("rival_us", "words"), [(0.0633, "158.0 times as fast."), (25.0, "2.5 times its time.")])
def test_no_ratio_is_rounded_to_zero(rival_us, words):
    rival = CROSSOVER["by_median"][0] | {"median_us": rival_us}
    found = Crossover.of(CROSSOVER | {"by_median": [rival]}, "a test")
    assert f" µs, {words}" in bench.network_pays(found)


def test_equal_accuracy_is_not_taken_from_one_lucky_grid():
    class Lucky:
        plant = PLANT

        def of_method(self, predictor, nx):
            return ErrorSizes(0.0 if nx == 5 else 1 / (nx - 1), 0.1 / (nx - 1))

    assert candidates.matching(Lucky(), RK4, 0.01) - 1 == 100  # not 4
    assert candidates.matching(Lucky(), RK4, 2.0) - 1 == 1
    assert candidates.matching(Lucky(), RK4, 1e-9) is None
    assert candidates.matching(Lucky(), RK4, 0.01, by="median") - 1 == 10


def test_a_rival_by_the_median_has_the_steps_that_its_median_error_needs():
    class Halved:
        plant = PLANT

        def of_method(self, predictor, nx):
            return ErrorSizes(1 / (nx - 1), 0.1 / (nx - 1))

    rival = entry("rk4", "compiled", 101, RK4(PLANT, 101), "fno")
    typical = bench._by_median(rival, Halved(), 0.01)
    assert typical is not None and typical.nx - 1 == 10 == typical.run.nx - 1
    assert typical.matches == "fno, median" and bench._by_median(rival, Halved(), 1e-9) is None
