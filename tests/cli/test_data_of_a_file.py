"""A pipeline that trains on the samples of a file."""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from npred.cli import app
from npred.lab.training.data.dataset import Dataset

PIPELINE = """
name = "{name}"
plant = "activator_repressor"
[generate]
{generate}
[train]
models = ["deeponet"]
[train.deeponet]
epochs = 1
width = 8
depth = 1
[evaluate]
X0 = [0.03, 30.0]
"""
BENCH = ("--set", "bench.dx=[0.1]", "--set", "bench.calls=5", "--set", "bench.batches=[1]")
SIMULATED = "samples = 200\nrollouts = 10\nt_end = 10.0\ndt = 0.01\nnx = 21"


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A folder with a pipeline and its data in a store."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "p.toml").write_text(PIPELINE.format(name="p", generate=SIMULATED))
    done = CliRunner().invoke(app, ["generate", str(folder / "p.toml"), "--store", str(folder / "store"), "-q"])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def call(store, tmp_path, monkeypatch):
    """A command in a folder of its own, with a copy of that pipeline, its store and its data."""
    shutil.copytree(store, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    (path,) = Path("store/generate").glob("*/data.h5")
    shutil.copyfile(path, "data.h5")
    return lambda *arguments: CliRunner().invoke(app, [*map(str, arguments), "--store", "store"])


def document(done):
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def test_a_pipeline_trains_on_a_file(call):
    Path("theirs.toml").write_text(PIPELINE.format(name="theirs", generate='data = "data.h5"'))
    stages = document(call("train", "theirs.toml", "--json"))
    assert stages["result"]["deeponet"]["samples"] == 180
    ours, theirs = (Dataset.read(path) for path in Path("store/generate").glob("*/data.h5"))
    for name in ("X", "u", "D_hat", "P", "rollout", "test"):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
    assert {row["action"] for row in document(call("train", "theirs.toml", "--json"))["stages"]} == {"hit"}
    timed = document(call("bench", "theirs.toml", "--json", *BENCH))["result"]["rows"]
    assert {row["predictor"] for row in timed} >= {"rk4", "deeponet"} and timed[0]["eps_sup"] > 0
    Path("data.h5").rename("elsewhere.h5")
    moved = document(call("train", "theirs.toml", "--json", "--set", "generate.data=elsewhere.h5"))
    assert {row["action"] for row in moved["stages"]} == {"hit"}, "what the file holds counts, not where it lies"


def test_bench_without_a_sample_after_the_first_delay_says_so(call):
    short = ("--set", "generate.t_end=0.5", "--set", "generate.nx=6")
    done = call("bench", "p.toml", *short, *BENCH)
    assert done.exit_code == 2
    assert "expected held-out samples after the first delay, got 20 before it" in done.stderr.splitlines()[-1]


def test_a_pipeline_whose_data_do_not_fit_is_told(call):
    Path("cart.toml").write_text(PIPELINE.format(name="cart", generate='data = "data.h5"'))
    done = call("generate", "cart.toml", "--set", "plant=cart_pole")
    assert done.exit_code == 2 and "expected shape (200, 4) for plant cart_pole, got (200, 2)" in done.stderr
    assert "generate.data: expected a file" in call("status", "cart.toml", "--set", "generate.data=none.h5").stderr
    with h5py.File("data.h5", "r+") as file:
        file["test"][:] = 0  # type: ignore[index]
    assert "expected rows of both kinds, got 0 of 200 held out" in call("generate", "cart.toml").stderr
