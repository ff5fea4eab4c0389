"""The scheduler: the networks of one pipeline in threads, the cells of a sweep in processes."""

import json
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

import fake_stages
import pytest
from conftest import TANK
from jobs import SMALL

from npred.base.errors import ConfigError, DivergedError
from npred.lab import config
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler import executors
from npred.lab.scheduler.cells import cells
from npred.lab.scheduler.executors import Here
from npred.lab.scheduler.plan import Planner, nodes
from npred.lab.scheduler.runner import Runner, Task, elsewhere
from npred.lab.store import Store
from npred.lab.store.manifest import versions


def one(pipeline: Path, jobs: int) -> list[tuple[str, str]]:
    planner = Planner(config.load(pipeline), Store(pipeline.parent / "s"), "cpu")
    outcomes = Runner(Console(quiet=True), jobs).run(planner, nodes(planner.config, ["evaluate"]))
    return [(outcome.node.name, outcome.action) for outcome in outcomes]


def test_the_networks_of_a_pipeline_train_side_by_side(fakes: Path, pipeline: Path, monkeypatch: pytest.MonkeyPatch):
    both, real = threading.Barrier(2, timeout=60), fake_stages.ANSWERS["train"]

    def train(job: Any) -> dict[str, Any]:
        both.wait()
        return real(job)

    monkeypatch.setitem(fake_stages.ANSWERS, "train", train)
    names = ["generate", "deeponet", "fno", "evaluate"]
    assert one(pipeline, jobs=2) == [(name, "run") for name in names]
    assert one(pipeline, jobs=2) == [(name, "hit") for name in names]


def test_one_job_does_the_stages_in_order(fakes: Path, pipeline: Path):
    one(pipeline, jobs=1)
    order = [line.rpartition(":")[0] for line in fakes.read_text().splitlines()]
    assert order == ["generate:", "train:deeponet", "train:fno", "evaluate:"]


def test_a_training_that_fails_stops_the_other_which_keeps_its_checkpoint(
    fakes: Path, pipeline: Path, monkeypatch: pytest.MonkeyPatch
):
    under_way, stopped = threading.Event(), threading.Event()

    def train(job: Any) -> dict[str, Any]:
        if job.model == "fno":
            assert under_way.wait(60)
            raise DivergedError("no finite loss")
        try:
            with job.progress.bar("train", 1, "epochs") as bar:
                while True:
                    under_way.set()
                    bar.advance(0)
        except KeyboardInterrupt:
            stopped.set()
            raise

    monkeypatch.setitem(fake_stages.ANSWERS, "train", train)
    with pytest.raises(DivergedError, match="no finite loss"):
        one(pipeline, jobs=2)
    assert stopped.wait(60)
    store = Store(pipeline.parent / "s")
    assert [artifact.manifest.question.stage for artifact in store.artifacts()] == ["generate"]
    assert (store.leftovers()[0] / "checkpoint").is_file()


def test_processes_make_the_same_bytes(tmp_path: Path):
    """Real stages: two processes, each a cell at a time, and one pipeline after the other."""
    path = tmp_path / "p.toml"
    lines = [
        f"[{name}]\n" + "\n".join(f"{k} = {json.dumps(v)}" for k, v in SMALL[name].items()) for name in ("generate",)
    ]
    network = "[train]\nmodels = ['fno']\n[train.fno]\nepochs = 1\nbatch = 64\nwidth = 4\nmodes = 3\nlayers = 1\n"
    path.write_text("plant = 'scalar'\n" + "\n".join(lines) + "\n" + network)
    grid, console = cells(path, ["train.fno.epochs=1,2"]), Console(quiet=True)
    with executors.opened("local", 2) as executor:
        planners = [Planner(cell.config, Store(tmp_path / "a"), "cpu") for cell in grid]
        runs = Runner(console, 2, executor).sweep(planners, ["train"])
    assert [run.failure for run in runs] == [""] * 2
    for cell in grid:
        Runner(console, 1).run(Planner(cell.config, Store(tmp_path / "b"), "cpu"), nodes(cell.config, ["train"]))
    digests = [{a.manifest.key: a.manifest.digest for a in Store(tmp_path / name).artifacts()} for name in "ab"]
    assert digests[0] == digests[1]
    assert len(digests[0]) == 3


class Killed(Here):
    """An executor whose processes do not live."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(BrokenExecutor("a process was killed"))
        return future


def test_a_process_that_dies_fails_its_cells_only(fakes: Path, pipeline: Path, tmp_path: Path):
    planners = [Planner(cell.config, Store(tmp_path / "s"), "cpu") for cell in cells(pipeline, ["seed=0:2"])]
    runs = Runner(Console(quiet=True), 1, Killed()).sweep(planners, ["train"])
    assert [run.failure for run in runs] == ["train deeponet: BrokenExecutor: a process was killed"] * 2
    assert [line.partition(":")[0] for line in fakes.read_text().splitlines()] == ["generate"] * 2


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError("Unable to allocate 745. GiB for an array"), "745. GiB for an array; take fewer nodes"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried to"), "got: DefaultCPUAllocator: can't"),
        (RuntimeError("another"), "^another$"),
    ],
)
def test_a_lack_of_memory_is_one_line(fakes: Path, pipeline: Path, monkeypatch: pytest.MonkeyPatch, error, words):
    def generate(job: Any) -> dict[str, Any]:
        raise error

    monkeypatch.setitem(fake_stages.ANSWERS, "generate", generate)
    with pytest.raises(type(error) if words.startswith("^") else ConfigError, match=words):
        one(pipeline, jobs=1)


@pytest.mark.parametrize("change", ["plant", "packages"])
def test_a_process_with_another_plant_or_package_makes_nothing(tmp_path: Path, monkeypatch, change: str):
    """What a worker reads at the plant's path may have changed, and what is installed there may be another version."""
    tank = tmp_path / "tank.py"
    tank.write_text(TANK)
    path = tmp_path / "p.toml"
    path.write_text("plant = 'tank.py:Tank'\n[generate]\nrollouts = 2\nsamples = 4\n")
    planner = Planner(config.load(path), Store(tmp_path / "s"), "cpu")
    (node,), expected = nodes(planner.config, ["generate"]), versions()
    task = Task(planner, node, planner.question(node, {}), "", {}).with_absolute_paths()
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
