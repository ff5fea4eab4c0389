"""A sweep over seeds on a GPU: its networks train together, each with the key, files and result that it has alone."""

import json
import threading
from pathlib import Path

import numpy as np
import pytest
from jobs import SMALL

from npred.errors import DivergedError
from npred.parallel.executors import Here
from npred.pipeline import CellRun, Planner, Runner, runner
from npred.pipeline.cells import cells
from npred.store import Store
from npred.terminal.console import Console
from npred.training import captured, training_loop


@pytest.fixture
def toml(tmp_path: Path) -> Path:
    tables = {
        "generate": SMALL["generate"] | {"samples": 200},
        "train": {"models": ["deeponet", "fno"]},
        "train.deeponet": SMALL["train"]["deeponet"],
        "train.fno": SMALL["train"]["fno"],
        "evaluate": {"X0": [0.03, 30.0]},
    }
    lines = [
        f"[{name}]\n" + "\n".join(f"{k} = {json.dumps(v)}" for k, v in table.items()) for name, table in tables.items()
    ]
    path = tmp_path / "seeds.toml"
    path.write_text('plant = "activator_repressor"\n' + "\n".join(lines))
    return path


@pytest.fixture
def stacks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sizes of the groups that train in one graph, the CPU being taken for a GPU."""
    sizes, real = [], captured.Captured
    monkeypatch.setattr(captured, "serves", lambda device: True)
    monkeypatch.setattr(runner, "_in_a_graph", lambda task: task.step.node.stage == "train")
    monkeypatch.setattr(training_loop, "Captured", lambda tasks: (sizes.append(len(tasks)), real(tasks))[1])
    return sizes


def swept(toml: Path, store: str, sets: str = "seed=0:3") -> list[CellRun]:
    planners = [Planner(cell.config, Store(toml.parent / store), "cpu") for cell in cells(toml, [sets])]
    return Runner(Console(quiet=True), 1, Here()).sweep(planners, ["train"])


def trained(runs: list[CellRun]) -> dict[str, list[dict[str, float]]]:
    """The metrics by key."""
    artifacts = [o.artifact for run in runs for name, o in run.outcomes.items() if name != "generate"]
    return {
        a.manifest.key: [json.loads(line) for line in (a.folder / "metrics.jsonl").read_text().splitlines()]
        for a in artifacts
    }


def test_each_seed_has_its_own_key_and_the_result_of_one_alone(toml, stacks, monkeypatch):
    together = trained(swept(toml, "together"))
    assert stacks == [3, 3]
    monkeypatch.undo()
    alone = trained(swept(toml, "alone"))
    assert together.keys() == alone.keys() and len(alone) == 6
    for key, expected in alone.items():
        for row, other in zip(together[key], expected, strict=True):
            np.testing.assert_allclose(
                list(row.values()), list(other.values()), rtol=2e-2
            )  # float32: SOAP amplifies it
    files = [sorted(p.name for p in (toml.parent / store / "train").rglob("*")) for store in ("together", "alone")]
    assert files[0] == files[1]


def test_what_the_store_has_is_not_made_again(toml, stacks):
    swept(toml, "s", "seed=1:3")
    runs = swept(toml, "s", "seed=0:4")
    assert stacks == [2, 2, 2, 2]
    assert [run.outcomes["fno"].action for run in runs] == ["run", "hit", "hit", "run"]


def test_a_seed_that_another_process_makes_keeps_nobody_waiting(toml, stacks):
    swept(toml, "s", "seed=0:3")
    expected = swept(toml, "probe", "seed=0:3")
    key, store = expected[1].outcomes["fno"].key, Store(toml.parent / "other")
    assert key
    stacks.clear()
    held, let_go = threading.Event(), threading.Event()

    def hold() -> None:
        with store.lock("train", key):
            held.set()
            let_go.wait(60)

    holder = threading.Thread(target=hold)
    holder.start()
    assert held.wait(60)
    done = threading.Event()
    original = training_loop.fit_side_by_side

    def fit(tasks, scratches, progress):  # the others train, and only then it is let go
        found = original(tasks, scratches, progress)
        if len(tasks) == 2:
            done.set()
            let_go.set()
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training_loop, "fit_side_by_side", fit)
        runs = swept(toml, "other", "seed=0:3")
    holder.join(60)
    assert done.is_set() and stacks == [3, 2, 1]
    assert [run.failure for run in runs] == ["", "", ""]


def test_a_seed_that_fails_stops_no_other(toml, stacks, monkeypatch):
    real = training_loop.fit_side_by_side

    def fit(tasks, scratches, progress):
        found = list(real(tasks, scratches, progress))
        return [DivergedError("no finite loss"), *found[1:]] if len(tasks) == 3 else found

    monkeypatch.setattr(training_loop, "fit_side_by_side", fit)
    runs = swept(toml, "s")
    assert [bool(run.failure) for run in runs].count(True) in (1, 2)  # one of each network, of whichever came first
    assert all("no finite loss" in run.failure for run in runs if run.failure)
    assert {run.outcomes["generate"].action for run in runs} == {"run"}
