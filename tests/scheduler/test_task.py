"""A node as work for another process."""

from pathlib import Path

import pytest
from conftest import TANK

from npred.lab import config
from npred.lab.scheduler.stage_registry import Planner, nodes
from npred.lab.scheduler.task import Task, elsewhere, packages
from npred.lab.store import Store


@pytest.mark.parametrize("change", ["plant", "packages"])
def test_a_process_with_another_plant_or_package_makes_nothing(tmp_path: Path, monkeypatch, change: str):
    """What a worker reads at the plant's path may have changed, and what is installed there may be another version."""
    tank = tmp_path / "tank.py"
    tank.write_text(TANK)
    path = tmp_path / "p.toml"
    path.write_text("plant = 'tank.py:Tank'\n[generate]\nrollouts = 2\nsamples = 4\n")
    planner = Planner(config.load(path), Store(tmp_path / "s"), "cpu")
    (node,), expected = nodes(planner.config, ["generate"]), packages()
    task = Task(planner, planner.step(node, planner.question(node, {})), {}).with_absolute_paths()
    monkeypatch.chdir("/")
    if change == "plant":
        tank.write_text(TANK.replace("u.q - x.h", "u.q - 2 * x.h"))
    else:
        expected = expected | {"numpy": "0.1"}
    outcome = elsewhere(task, expected)
    assert outcome.result is None and planner.store.artifacts() == []
    assert outcome.failure == (
        "generate: expected the same plant, delay law and packages on every worker, got others; install them there"
    )
