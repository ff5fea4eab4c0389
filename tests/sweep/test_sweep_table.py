"""The rows of a sweep's table."""

from pathlib import Path

import fake_stages
import pytest
from result_samples import BENCHED, SCORES, evaluated, timing

from npred.pipeline import STAGES, Planner, Runner
from npred.store import Store
from npred.sweep import cells
from npred.sweep.sweep_table import rows
from npred.terminal.console import Console


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
    (fno, snapshot) = rows(grid[0], run)
    numbers = {"mse": 0.1, "eps_sup": 0.2, "eps_kappa": 0.3, "radius": 1.0, "radius_worst": None, "converged": 0.5}
    assert fno == {"seed": "3", "model": "fno", **numbers, "latency_us": 5.0, "artifact": fno["artifact"]}
    assert fno["artifact"].startswith("bench/")
    assert (snapshot["model"], snapshot["latency_us"]) == ("fno@7", None)
