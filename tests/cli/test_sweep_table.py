"""The rows of a sweep's table, and the front: what no other row beats in every quantity that is known."""

from pathlib import Path

import fake_stages
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from result_samples import BENCHED, SCORES, evaluated, timing

from npred.cli import sweep as sweep_table
from npred.cli.sweep import Row, rows_of
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.cells import cells
from npred.lab.scheduler.plan import STAGES, Planner
from npred.lab.scheduler.runner import Runner
from npred.lab.store import Store


def test_a_row_has_errors_radius_and_the_fastest_runtime(
    pipeline: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    radius = {"median": 1.0, "worst": None, "converged": 0.5, "cases": 4, "predicted": 0.1}
    measured = SCORES | {"mse": 0.1, "eps_sup": 0.2, "eps_kappa": 0.3, "radius": radius}
    times = [
        ("fno", 0.01, 1, 9.0),
        ("fno", 0.01, 1, 5.0),
        ("fno", 0.01, 64, 1.0),
        ("fno", 0.005, 1, 2.0),
        ("rk4", 0.01, 1, 3.0),
    ]
    bench = [timing(p, "fused", dx, us, batch=b).json_object() for p, dx, b, us in times]
    contenders = ("numerical", "no_adaptation", "fno", "fno@7")
    answers = {
        "evaluate": lambda job: evaluated(dict.fromkeys(contenders, measured)),
        "bench": lambda job: BENCHED | {"rows": bench},
    }
    table = dict(STAGES)
    fake_stages.install(table)
    for name, stage in table.items():
        monkeypatch.setitem(STAGES, name, stage)
    for name, answer in answers.items():
        monkeypatch.setitem(fake_stages.ANSWERS, name, answer)
    grid = cells(pipeline, ["train.models=['fno']", "seed=3,4"])
    planners = [Planner(cell.config, Store(tmp_path / "s"), "cpu") for cell in grid]
    (run, _) = Runner(Console(quiet=True), 1).sweep(planners, ["evaluate", "bench"])
    (fno, snapshot) = rows_of(grid[0], run)
    numbers = {"mse": 0.1, "eps_sup": 0.2, "eps_kappa": 0.3, "radius": 1.0, "radius_worst": None, "converged": 0.5}
    assert fno.cells() == {"seed": "3", "model": "fno", **numbers, "latency_us": 5.0, "artifact": fno.artifact}
    assert fno.artifact.startswith("bench/")
    assert (snapshot.model, snapshot.numbers["latency_us"]) == ("fno@7", None)


def row(eps: float | None, latency: float | None = None, radius: float | None = None) -> dict[str, float | None]:
    return {"eps_sup": eps, "latency_us": latency, "radius_worst": radius}


def networks(rows: list[dict[str, float | None]]) -> list[Row]:
    return [Row({}, "fno", numbers, "evaluate/0123456789ab") for numbers in rows]


def test_the_front_of_errors_and_latencies():
    rows = [row(1.0, 5.0), row(0.5, 9.0), row(2.0, 6.0), row(0.5, 9.0), row(0.6, None), row(None, 1.0)]
    assert sweep_table.front(rows) == [True, True, False, True, False, False]


def test_one_quantity_and_none():
    assert sweep_table.front([row(2.0), row(1.0), row(None)]) == [False, True, False]
    assert sweep_table.front([row(None), row(None)]) == [False, False]
    assert sweep_table.front([]) == []


@given(st.lists(st.tuples(*[st.integers(0, 4)] * 3), min_size=1, max_size=12))
def test_every_point_that_is_dominated_is_so_by_one_that_is_not(points: list[tuple[int, int, int]]):
    array = np.array(points, dtype=float)
    lost = sweep_table.dominated(array)
    assert not lost.all()
    for point in array[lost]:
        assert any((p <= point).all() and (p < point).any() for p in array[~lost])
    for point in array[~lost]:
        assert not any((p <= point).all() and (p < point).any() for p in array)


def test_a_panel_for_each_pair_that_is_known_and_the_same_bytes(tmp_path: Path):
    rows = [row(1.0, 5.0, 0.0), row(0.5, 9.0, 2.0), row(0.5, None, None)]
    written = []
    for _ in range(2):
        assert sweep_table.draw(tmp_path, networks(rows)) == [tmp_path / "front.svg", tmp_path / "front.png"]
        written.append((tmp_path / "front.svg").read_bytes())
    assert written[0] == written[1]
    assert written[0].decode().count("<!-- µs per call -->") == 2
    assert sweep_table.draw(tmp_path, networks([row(1.0), row(2.0)])) == []
