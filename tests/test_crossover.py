"""When a network pays: arithmetic on made-up latencies."""

import pytest
from jobs import job

from npred import plants
from npred.stages import contenders, crossover


def test_break_even_is_where_both_take_as_long(tmp_path, monkeypatch):
    """1 us a call and 0.1 us an evaluation: 10 steps take 5 us, so a network of 9 us pays from 0.2 us on."""
    plant = job(tmp_path, "bench").plant
    monkeypatch.setattr(crossover, "_median", lambda job, plant, run, nx: 1.0 + 0.1 * 4 * (nx - 1))
    found = crossover._crossover(job(tmp_path, "again"), plant, 9.0, 10)
    assert found["f_ns"] == pytest.approx(100) and found["rk4_us"] == pytest.approx(5.0)
    assert found["pays_from_ns"] == pytest.approx(200) and found["network_speedup"] == pytest.approx(5 / 9)


@pytest.mark.parametrize(
    ("speedup", "trained", "words"),
    [
        (0.5, True, "is rk4 with 10 steps, by 2.0x over a fno (fused): 10.0 us the network, 5.0 us rk4."),
        (4.0, False, "is a fno (fused), if trained to that accuracy, by 4.0x over rk4 with 10 steps"),
    ],
)
def test_sentence(speedup, trained, words):
    found = {"plant": "arm", "eps_sup": 0.02, "rk4_steps": 10, "rk4_us": 5.0, "network_us": 10.0, "f_ns": 80.0,
             "network_speedup": speedup, "pays_from_ns": 200.0, "predictor": "fno", "runtime": "fused",
             "trained": trained}  # fmt: skip
    text = crossover.sentence(found)
    assert words in text and text.endswith("A network pays from 200 ns an evaluation of f on (here 80 ns).")


def test_equal_accuracy_is_not_taken_from_one_lucky_grid():
    class Lucky:
        plant = plants.resolve("scalar")

        def of(self, predictor, nx):
            return 0.0 if nx == 5 else 1 / (nx - 1)

    assert contenders.matching(Lucky(), 0.01) - 1 == 114  # the first of the ladder from 100 on
    assert contenders.matching(Lucky(), 1e-9) == contenders.FINE
