"""Several processes train as one does: the same loss curve for the same global batch, one result in the store."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import process_environment
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from npred.cli import app
from npred.parallel import torchrun

TINY = """
name = "tiny"
plant = "activator_repressor"
seed = 1
[generate]
samples = 600
rollouts = 12
t_end = 8.0
dt = 0.01
nx = 21
[train.deeponet]
epochs = 4
batch = 61
width = 16
depth = 2
basis = 8
snapshots = [2]
[train.fno]
epochs = 2
batch = 64
width = 4
modes = 3
layers = 1
optimiser = "adam"
"""
TWO = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "npred"]


@given(st.integers(1, 40), st.integers(1, 9), st.integers(0, 2**31))
def test_weighted_parts_make_the_mean_of_the_batch(rows, count, seed):
    losses, found, taken = np.random.default_rng(seed).normal(size=rows), 0.0, []
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(torchrun.LAUNCHED, "run")
        patch.setenv("WORLD_SIZE", str(count))
        for rank in range(count):
            patch.setenv("RANK", str(rank))
            some, weight = torchrun.part(rows)
            found += weight * losses[some].mean() / count
            taken += list(range(rows)[some]) if weight else []
    assert found == pytest.approx(losses.mean(), abs=1e-12) and sorted(taken) == list(range(rows))


@pytest.mark.parametrize("world", ["", "2", "many"])
def test_one_process_is_as_ever(monkeypatch, world):
    monkeypatch.delenv(torchrun.LAUNCHED, raising=False)
    monkeypatch.setenv("RANK", "3")  # other launchers set it too
    monkeypatch.setenv("WORLD_SIZE", world)
    assert (torchrun.count(), torchrun.number(), torchrun.device("cuda")) == (1, 0, "cuda")
    assert torchrun.part(7) == (slice(0, None, 1), 1.0)
    module = object()
    assert torchrun.shared(module) is module  # type: ignore[type-var]
    torchrun.join()
    torchrun.dismiss()


def test_each_process_has_a_gpu_of_its_own(monkeypatch):
    for name, value in {torchrun.LAUNCHED: "run", "WORLD_SIZE": "4", "RANK": "3", "LOCAL_RANK": "1"}.items():
        monkeypatch.setenv(name, value)
    assert (torchrun.device("cuda"), torchrun.device("cpu")) == ("cuda:1", "cpu")


def test_the_end_flushes_what_was_said_and_takes_nothing_down():
    """A gloo thread that frees a tensor while the interpreter is taken down aborts the process, one run in four."""
    program = (
        "import atexit, sys\nfrom npred.parallel import torchrun as ranks\natexit.register(print, 'taken down')\n"
        "print('said')\nprint('told', file=sys.stderr)\nranks.leave(3)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], env=process_environment(), capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (3, "said\n", "told\n")


def npred(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [*TWO, "train", "tiny.toml", "--device", "cpu", *arguments]
    return subprocess.run(command, cwd=folder, env=process_environment(), capture_output=True, text=True, timeout=240)


def curves(store: Path) -> dict[str, np.ndarray]:
    found = {}
    for path in store.glob("train/*/metrics.jsonl"):
        name = json.loads((path.parent / "model.json").read_text())["model"]
        found[name] = np.array([json.loads(line)["loss"] for line in path.read_text().splitlines()])
    return found


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A store with the data."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "tiny.toml").write_text(TINY)
    done = CliRunner().invoke(app, ["generate", str(folder / "tiny.toml"), "--store", str(folder / "store"), "-q"])
    assert done.exit_code == 0, done.output
    return folder / "store"


@pytest.fixture
def made(tmp_path, data):
    """Data in two equal stores."""
    (tmp_path / "tiny.toml").write_text(TINY)
    for name in ("one", "two"):
        shutil.copytree(data, tmp_path / name)
    return tmp_path


@pytest.mark.slow
def test_two_processes_have_the_loss_curve_of_one(made):
    """To the rounding of sums with Adam; SOAP's eigenbases make more of that rounding."""
    alone = CliRunner().invoke(app, ["train", str(made / "tiny.toml"), "--store", str(made / "one"), "-q"])
    assert alone.exit_code == 0, alone.output
    done = npred(made, "--store", "two", "--json", "-q")
    assert done.returncode == 0, done.stderr
    one, two = curves(made / "one"), curves(made / "two")
    np.testing.assert_allclose(two["fno"], one["fno"], rtol=1e-5)
    np.testing.assert_allclose(two["deeponet"], one["deeponet"], rtol=2e-2)
    np.testing.assert_allclose(two["deeponet"][0], one["deeponet"][0], rtol=1e-3)
    assert [row["action"] for row in json.loads(done.stdout)["stages"]] == ["hit", "run", "run"]
    keys = [{path.name for path in (made / store / "train").iterdir()} for store in ("one", "two")]
    assert keys[0] == keys[1], "how many processes train is in no key"
    again = npred(made, "--store", "two", "--json", "-q")
    assert [row["action"] for row in json.loads(again.stdout)["stages"]] == ["hit", "hit", "hit"]


@pytest.mark.slow
def test_a_failure_ends_all_processes(made):
    done = npred(made, "--store", "two", "--set", "train.fno.lr=1e30", "--model", "fno", "-q")
    assert done.returncode != 0 and "error: train fno: expected a finite loss" in done.stderr
    assert not list((made / "two").glob("train/*"))
    bad = npred(made, "--store", "two", "--set", "train.fno.epochs=0", "-q")
    assert bad.returncode != 0 and "error: tiny.toml: train.fno.epochs: expected" in bad.stderr
    assert not [name for name in os.listdir(made / "two" / ".tmp") if name.startswith("train")]
