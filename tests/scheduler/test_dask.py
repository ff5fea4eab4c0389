"""A Dask cluster of two local workers makes the bytes that one process makes, also where a worker is killed."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import TANK, process_environment
from jobs import job
from silent import Silent

from npred.base.errors import ConfigError
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler import executors
from npred.lab.scheduler.cells import cells
from npred.lab.scheduler.executors import Here
from npred.lab.scheduler.plan import Planner
from npred.lab.scheduler.runner import Runner
from npred.lab.stages.generate import generate
from npred.lab.store import Store
from npred.lab.training.data import shards

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow
SIZES = {"rollouts": 832, "samples": 2496, "t_end": 8.0}  # thirteen chunks of rollouts
TINY = """
name = "tiny"
plant = "activator_repressor"
[generate]
samples = 600
rollouts = 200
t_end = 4.0
dt = 0.01
nx = 21
"""


@pytest.fixture(scope="module")
def cluster():
    """Two workers, a process each, that nobody outside this machine can reach."""
    addresses = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(2, threads_per_worker=1, silence_logs=50, **addresses) as cluster:
        yield cluster


@pytest.fixture
def executor(cluster):
    with executors.opened(f"dask:{cluster.scheduler_address}", jobs=1) as executor:
        yield executor


def pids(executor) -> set[int]:
    """Workers that answer."""
    return {executor.submit(os.getpid).result() for _ in range(8)}


class Killer(Silent):
    """Kills a worker with -9 as soon as some work is done, while the rest is under way."""

    def __init__(self, executor) -> None:
        super().__init__()
        self.executor, self.killed = executor, 0

    def advance(self, n: int = 1, note: str = "") -> None:
        super().advance(n, note)
        if n and not self.killed:
            self.killed = min(pids(self.executor))
            os.kill(self.killed, signal.SIGKILL)


def payload(tmp_path, name, executor=None, progress=None):
    made = job(tmp_path, name, executor=executor, generate=SIZES)
    generate.run(made if progress is None else type(made)(**(vars(made) | {"progress": progress})))
    return {path.name: path.read_bytes() for path in made.folder.iterdir()}


@pytest.mark.parametrize("large", [False, True], ids=["one file", "shards"])
def test_a_killed_worker_changes_no_byte(tmp_path, executor, monkeypatch, large):
    if large:
        monkeypatch.setattr(shards, "WHOLE", 1)
        monkeypatch.setattr(shards, "SHARD", 1)
    alone = payload(tmp_path, "alone")
    assert len(alone) == (14 if large else 1)
    assert payload(tmp_path, "cluster", executor) == alone
    killer = Killer(executor)
    assert payload(tmp_path, "killed", executor, killer) == alone
    assert killer.killed and killer.killed not in pids(executor)


def test_the_command_line_gives_the_same_digests(cluster, tmp_path):
    (tmp_path / "tiny.toml").write_text(TINY)
    found = []
    for name, executor in (("local", "local"), ("dask", f"dask:{cluster.scheduler_address}")):
        words = f"generate tiny.toml -q --store {name} --executor {executor}"
        command = [sys.executable, "-m", "npred", *words.split()]
        subprocess.run(command, cwd=tmp_path, env=process_environment(), check=True, capture_output=True)
        (manifest,) = (tmp_path / name).glob("generate/*/manifest.json")
        written = json.loads(manifest.read_text())
        found.append((written["key"], written["digest"]))
    assert found[0] == found[1]


def test_an_error_of_a_task_comes_back_as_it_is(executor):
    with pytest.raises(ConfigError, match="nonesuch"):
        executor.submit(raise_config_error, "nonesuch").result()


def raise_config_error(text: str) -> None:
    raise ConfigError(text)


def test_a_sweep_on_the_cluster_makes_the_bytes_of_one_here(tmp_path, executor, monkeypatch):
    """A plant of one's own by a relative path, which in the workers' folder is another file or none."""
    (tmp_path / "tank.py").write_text(TANK)
    sizes = "[generate]\nrollouts = 8\nsamples = 64\nt_end = 2.0\nnx = 11\n[train]\nmodels = ['fno']\n"
    network = "[train.fno]\nepochs = 1\nbatch = 64\nwidth = 4\nmodes = 3\nlayers = 1\n"
    (tmp_path / "p.toml").write_text("plant = 'tank.py:Tank'\n" + sizes + network)
    monkeypatch.chdir(tmp_path)
    grid, digests = cells(Path("p.toml"), ["seed=0:2"]), []
    for name, where in (("here", Here()), ("there", executor)):
        store = Store(tmp_path / name)
        planners = [Planner(cell.config, store, "cpu") for cell in grid]
        runs = Runner(Console(quiet=True), 1, where).sweep(planners, ["train"])
        assert [run.failure for run in runs] == ["", ""]
        digests.append({a.manifest.key: a.manifest.digest for a in store.artifacts()})
    assert digests[0] == digests[1] and len(digests[0]) == 4
