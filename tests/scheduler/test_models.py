"""A network of a user's file beside the built-in ones: trained, evaluated, exported, and found again."""

import json
from pathlib import Path

import pytest
from conftest import HERE
from jobs import SMALL
from typer.testing import CliRunner, Result

import npred
from npred.base.errors import ConfigError
from npred.cli import app
from npred.lab.config import dumps

NET = """
import torch

class Plain(torch.nn.Module):
    def __init__(self, n, m, clock=0, *, width):
        super().__init__()
        self.layer = torch.nn.Linear(n + clock + m + 1, width)
        self.last = torch.nn.Linear(width, n)

    def forward(self, X, u, D_hat, stride=1):
        means = torch.cumsum(u, dim=1)[:, ::stride] / u.shape[1]
        constants = torch.cat([X, D_hat[:, None]], dim=1)[:, None].expand(-1, means.shape[1], -1)
        return self.last(torch.tanh(self.layer(torch.cat([constants, means], dim=2))))
"""
MINE = {"network": "net.py:Plain", "sizes": {"width": 4}, "epochs": 1, "batch": 64, "snapshots": [1]}


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A pipeline whose networks are a user's, a DeepONet of a chosen name, and two of files of npred's pipelines."""
    monkeypatch.setenv("NPRED_STORE", str(tmp_path / "store"))
    (tmp_path / "net.py").write_text(NET)
    small = {"network": "deeponet", "sizes": {"width": 8, "depth": 1, "basis": 4}, "epochs": 1}
    train = {"models": ["mine", "small", "averaging", "gru"], "mine": MINE, "small": small}
    for name, kind in {"averaging": "AveragingNetwork", "gru": "GRUNetwork"}.items():
        train[name] = {"network": f"{HERE.parent}/pipeline/{name}.py:{kind}", "epochs": 1, "sizes": {"width": 4}}
    path = tmp_path / "own.toml"
    short = SMALL["evaluate"] | {"t_end": 2.0, "case_t_end": 3.0}
    path.write_text(dumps({"plant": "activator_repressor"} | SMALL | {"train": train, "evaluate": short}))
    return path


def call(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def refusal(*words: object) -> str:
    done = call(*words)
    assert done.exit_code == 2 and len(done.stderr.strip().splitlines()) == 1, done.output
    return done.stderr


def test_before_anything_runs_the_sizes_are_those_of_the_class(file: Path):
    assert "no width; give it a value" in refusal("status", file, "--set", "train.mine.sizes={}")
    said = refusal("train", file, "--set", "train.gru.sizes.stepz=3")
    assert "train.gru.sizes: expected keyword arguments of GRUNetwork (width, steps, layers), got stepz" in said
    assert "steps" in said and not list((file.parent / "store").glob("generate/*"))


def test_a_network_of_a_file_is_trained_found_and_kept_by_what_the_file_holds(file: Path, tmp_path: Path):
    assert call("train", file, "-q", "--model", "mine").exit_code == 0
    (folder,) = (tmp_path / "store" / "train").iterdir()
    manifest = json.loads((folder / "manifest.json").read_text())
    assert set(manifest["question"]["config"]["train"]["mine"]["network"]) == {"name", "source"}
    assert json.loads((folder / "model.json").read_text())["model"] == "net.py:Plain"
    assert npred.load(f"{file}:mine@1")([0.05, 20.0], [[0.0]] * 11, 1.0).shape == (11, 2)
    with pytest.raises(ConfigError, match=r"expected a registered network, got net.py:Plain; use PIPELINE:MODEL"):
        npred.load(folder.name)
    (tmp_path / "net.py").write_text(NET.replace("tanh", "sin"))
    said = call("why", "mine", file).stdout
    assert said.startswith("train mine: train.mine.network.source: ")


def test_a_network_that_was_trained_with_set_is_loaded_with_the_same_settings(file: Path):
    assert call("train", file, "-q", "--model", "small", "--set", "train.small.sizes.width=6").exit_code == 0
    with pytest.raises(ConfigError, match=r"got none .* or give the --set that it was trained with, in Python `sett"):
        npred.load(f"{file}:small")
    model = npred.load(f"{file}:small", settings={"train.small.sizes.width": 6})
    assert model([0.05, 20.0], [[0.0]] * 101, 1.0).shape == (101, 2)
    (folder,) = (file.parent / "store/train").iterdir()
    with pytest.raises(ConfigError, match="expected PIPELINE:MODEL, whose keys can be set, got a result"):
        npred.load(str(folder), settings={"seed": 1})


@pytest.mark.slow
def test_every_network_is_evaluated_timed_drawn_and_exported_but_not_to_c(file: Path, tmp_path: Path):
    pytest.importorskip("onnxruntime")
    sets = ('bench.runtimes=["torch","fused","onnx"]', "bench.dx=[0.1]", "bench.batches=[1]")
    done = call("run", file, "--json", *(word for text in sets for word in ("--set", text)))
    assert done.exit_code == 0, done.output
    noted = [line for line in done.stderr.splitlines() if "no fused form" in line]
    assert [stage for line in noted for stage in ("evaluate", "bench") if line.startswith(f"{stage}: ")] == (
        ["evaluate"] * 3 + ["bench"] * 3
    )
    rows = json.loads(done.stdout)["result"]["rows"]
    timed = {name: {row["runtime"] for row in rows if row["predictor"] == name} for name in ("mine", "gru", "small")}
    assert timed["small"] == {"torch", "fused", "onnx"} and timed["mine"] == timed["gru"] == {"torch", "onnx"}
    (page,) = (tmp_path / "store").glob("report/*/report.html")
    assert "net.py:Plain" in page.read_text() and "averaging" in page.read_text()
    assert call("export", "onnx", f"{file}:mine", "-o", tmp_path / "mine.onnx", "--nx", 21).exit_code == 0
    assert call("export", "c", f"{file}:small", "-o", tmp_path / "small.c", "--nx", 21).exit_code == 0
    said = refusal("export", "c", f"{file}:mine", "-o", tmp_path / "mine.c")
    assert "export c: expected a network that can be lowered (deeponet, fno), got Plain; use npred export onnx" in said
    with pytest.raises(ConfigError, match=r"^fused: expected a network that can be lowered .* got mine; "):
        npred.load(f"{file}:mine", runtime="fused")
