"""The front: what no other row beats in every quantity that is known."""

from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from npred.sweep import pareto


def row(
    eps: float | None, latency: float | None = None, radius: float | None = None, number: int = 1
) -> dict[str, Any]:
    return {"row": number, "model": "fno", "eps_sup": eps, "latency_us": latency, "radius_worst": radius}


def test_the_front_of_errors_and_latencies():
    rows = [row(1.0, 5.0), row(0.5, 9.0), row(2.0, 6.0), row(0.5, 9.0), row(0.6, None), row(None, 1.0)]
    assert pareto.front(rows) == [True, True, False, True, False, False]


def test_one_quantity_and_none():
    assert pareto.front([row(2.0), row(1.0), row(None)]) == [False, True, False]
    assert pareto.front([row(None), row(None)]) == [False, False]
    assert pareto.front([]) == []


@given(st.lists(st.tuples(*[st.integers(0, 4)] * 3), min_size=1, max_size=12))
def test_every_point_that_is_dominated_is_so_by_one_that_is_not(points: list[tuple[int, int, int]]):
    array = np.array(points, dtype=float)
    lost = pareto.dominated(array)
    assert not lost.all()
    for point in array[lost]:
        assert any((p <= point).all() and (p < point).any() for p in array[~lost])
    for point in array[~lost]:
        assert not any((p <= point).all() and (p < point).any() for p in array)


def test_a_panel_for_each_pair_that_is_known_and_the_same_bytes(tmp_path: Path):
    rows = [row(1.0, 5.0, 0.0, 1), row(0.5, 9.0, 2.0, 2), row(0.5, None, None, 3)]
    written = []
    for _ in range(2):
        assert pareto.draw(tmp_path, rows) == [tmp_path / "front.svg", tmp_path / "front.png"]
        written.append((tmp_path / "front.svg").read_bytes())
    assert written[0] == written[1]
    assert written[0].decode().count("<!-- µs per call -->") == 2
    assert pareto.draw(tmp_path, [row(1.0), row(2.0)]) == []
