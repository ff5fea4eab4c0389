"""`npred import` and `npred export` of data, and a pipeline that trains on what came in."""

import errno
import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from npred.cli import app, data_exchange
from npred.data.dataset import MEANING, Dataset

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
    folder = tmp_path_factory.mktemp("exchange")
    (folder / "p.toml").write_text(PIPELINE.format(name="p", generate=SIMULATED))
    done = CliRunner().invoke(app, ["generate", str(folder / "p.toml"), "--store", str(folder / "store"), "-q"])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def call(store, tmp_path, monkeypatch):
    """A command in a folder of its own, with a copy of that pipeline and store."""
    shutil.copytree(store, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(app, [*map(str, arguments), "--store", "store"])


def document(done, code=0):
    assert done.exit_code == code, done.output
    return json.loads(done.stdout)


def kept() -> Dataset:
    (path,) = Path("store/generate").glob("*/data.h5")
    return Dataset.read(path)


def test_npy_out_and_in_again_is_the_same_data_and_trains(call):
    out = document(call("export", "npy", "p.toml", "-o", "theirs.npy", "--json"))
    assert out["files"] == ["theirs-inputs.npy", "theirs-outputs.npy"]
    given = ("import", "npy", *out["files"], "--rollouts", "10")
    found = document(call(*given, "--json"))
    assert (found["samples"], found["nx"], found["checks"]["start"]) == (200, 21, {"x1": 0.0, "x2": 0.0})
    assert found["splits"]["rows"]["nearest"] < found["splits"]["rollouts"]["nearest"]
    back, ours = Dataset.read(Path("data.h5")), kept()
    for name in ("X", "u", "D_hat", "P", "rollout"):
        np.testing.assert_array_equal(getattr(back, name), getattr(ours, name))
    Path("theirs.toml").write_text(PIPELINE.format(name="theirs", generate='data = "data.h5"'))
    stages = document(call("train", "theirs.toml", "--json"))
    assert stages["result"]["deeponet"]["samples"] == 180
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


def test_people_are_told_what_holds_and_what_to_do(call):
    call("export", "npy", "generate")
    told = call("import", "npy", "data-inputs.npy", "data-outputs.npy")
    assert told.exit_code == 0 and told.stderr == ""
    for words in ("200 samples on 21 nodes", "split by rows: 20 rows held out", 'data = "data.h5" below [generate]'):
        assert words in told.stdout


def test_doubts_are_warned_of(call):
    call("export", "npy", "generate")
    outputs = np.load("data-outputs.npy").reshape(200, 21, 2)
    inputs = np.load("data-inputs.npy").reshape(200, 21, 4)
    order = np.random.default_rng(0).permutation(200)
    np.save("i.npy", inputs[order, :-1].reshape(200, -1))
    np.save("o.npy", (outputs * [1.0, 1.5])[order, :-1].reshape(200, -1))
    warned = call("import", "npy", "i.npy", "o.npy", "--rollouts", "10").stderr
    assert "x2: P = X + D_hat ∫ f(P, u) leaves" in warned
    assert "do the nodes end at x = 1?" in warned
    assert "the rows look shuffled" in warned


def test_what_is_no_number_is_doubted_and_written_as_none(call):
    """The square of what P moves leaves the finite numbers, and a NaN is above no limit."""
    call("export", "npy", "generate")
    outputs = np.load("data-outputs.npy")
    outputs[3, -1] = 1e200
    np.save("data-outputs.npy", outputs)
    done = call("import", "npy", "data-inputs.npy", "data-outputs.npy", "--json")
    assert document(done)["checks"]["relative"]["x2"] is None
    assert "x2: P = X + D_hat ∫ f(P, u) leaves" in done.stderr and "Warning" not in done.stderr


def test_hdf5_and_mat_hold_every_array(call):
    pytest.importorskip("scipy")
    from scipy.io import loadmat

    assert call("export", "hdf5", "generate", "-o", "a.h5").exit_code == 0
    assert call("export", "mat", "generate").stdout.startswith("data.mat: 200 samples of generate/")
    ours, mat = kept(), loadmat("data.mat")
    for name in MEANING:
        np.testing.assert_array_equal(getattr(Dataset.read(Path("a.h5")), name), getattr(ours, name))
        np.testing.assert_array_equal(np.squeeze(mat[name]), np.squeeze(getattr(ours, name)))


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["import", "csv", "a", "b"], 2, "import: expected npy, got 'csv'"),
        (["import", "npy", "a.npy", "b.npy"], 2, "a.npy: expected an .npy file of numbers"),
        (["export", "npy", "0123"], 2, "expected one artifact"),
        (["export", "npy", "none.toml"], 2, "none.toml: expected a pipeline file"),
        (["export", "hdf5", "generate", "-o", "nowhere/a.h5"], 2, "expected a file that can be written"),
        (["export", "hdf5", "generate", "-o", "/dev/null"], 2, "/dev/null: expected a file that can be written"),
        (["import", "npy", "a.npy", "b.npy", "-o", "a.npy"], 2, "expected another file than the two, got --output a.n"),
    ],
)
def test_mistakes_are_told_in_one_line(call, arguments, code, words):
    done = call(*arguments)
    assert (done.exit_code, done.stdout) == (code, "")
    (line,) = done.stderr.splitlines()
    assert words in line


def test_a_pipeline_whose_data_do_not_fit_is_told(call):
    call("export", "hdf5", "generate", "-o", "a.h5")
    Path("cart.toml").write_text(PIPELINE.format(name="cart", generate='data = "a.h5"'))
    done = call("generate", "cart.toml", "--set", "plant=cart_pole")
    assert done.exit_code == 2 and "expected shape (200, 4) for plant cart_pole, got (200, 2)" in done.stderr
    assert "generate.data: expected a file" in call("status", "cart.toml", "--set", "generate.data=none.h5").stderr
    with h5py.File("a.h5", "r+") as file:
        file["test"][:] = 0  # type: ignore[index]
    assert "expected rows of both kinds, got 0 of 200 held out" in call("generate", "cart.toml").stderr


@pytest.mark.parametrize("form", ["npy", "hdf5", "mat"])
def test_a_disk_that_fills_is_one_line_and_leaves_nothing(call, monkeypatch, form):
    def full(source, data, path):
        path.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setitem(data_exchange.WRITERS, form, full)
    done = call("export", form, "generate", "-o", "a.out")
    assert (done.exit_code, done.stdout) == (1, "")
    assert "expected room to write, got a full disk" in done.stderr and not list(Path().glob("*.out"))
    assert not list(Path().glob(".npred-*"))


def test_what_is_no_data_cannot_be_exported_as_such(call):
    assert call("train", "p.toml", "-q").exit_code == 0
    done = call("export", "npy", "deeponet")
    assert done.exit_code == 2 and "deeponet: expected data, got train/" in done.stderr
