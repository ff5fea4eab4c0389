"""generate, train and evaluate from Python: the store and the keys of the command line, and one view in a notebook."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import HERE, process_environment
from jobs import tables

import npred
from npred.base.errors import ConfigError
from npred.lab.config import dumps
from npred.lab.config.results import Evaluated, PredictorId
from npred.lab.scheduler import sources
from npred.lab.scheduler.plan import Planner, nodes
from npred.lab.store import Store

NOTEBOOK = HERE.parent / "docs" / "notebooks" / "network.ipynb"


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A pipeline file of one network."""
    made = tables()
    made["train"] |= {"models": ["deeponet"]}
    path = tmp_path / "small.toml"
    path.write_text(dumps({"name": "small"} | made))
    return path


def test_a_plant_has_the_defaults_and_settings_change_them():
    made = sources.resolved(npred.plant("scalar", a=0.25), {"generate.samples": np.int64(900), "train.models": ["fno"]})
    assert (made.plant, made.parameters["a"]) == ("scalar", 0.25)
    assert (made.generate.samples, made.train.models) == (900, ["fno"])


def test_a_name_is_a_pipelines_before_a_plants(small: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(small.parent)
    assert sources.resolved("scalar").generate.samples == 40000  # as npred generate scalar has it
    assert sources.resolved("planar_arm2").plant == "planar_arm2"
    assert sources.resolved("small.toml") == sources.resolved(small) == sources.resolved(sources.resolved(small))


def test_a_plants_file_is_the_plant(tank_file: Any):
    assert sources.resolved(tank_file()).plant == tank_file()


@pytest.mark.parametrize(("source", "settings", "message"), [
    ("tonk", {}, "tonk: expected a pipeline file"),
    ("nowhere.toml", {}, "nowhere.toml: expected a pipeline file"),
    ("scalar", {"generate.sample": 3}, "generate.sample"),
    ("scalar", {"seed.x": 3}, "settings: seed.x: expected a table"),
])  # fmt: skip
def test_what_there_is_none_of_is_said_in_a_line(source: str, settings: dict[str, Any], message: str):
    with pytest.raises(ConfigError, match=message) as caught:
        sources.resolved(source, settings)
    assert "\n" not in str(caught.value)


def test_a_plant_that_is_a_class_has_no_name_to_keep_results_by():
    from npred import plants
    from npred.plants.builtin.scalar import Scalar

    with pytest.raises(ConfigError, match=r"write it to a file"):
        npred.generate(plants.make("mine", Scalar))


def test_a_network_that_a_pipeline_does_not_have_is_refused(small: Path):
    with pytest.raises(ConfigError, match="model: expected one of deeponet"):
        npred.train(small, "fnoo")


def test_stages_from_python_are_those_of_the_command_line(small: Path, capsys: pytest.CaptureFixture[str]):
    store = small.parent / "store"
    data = npred.generate(small, store=store, jobs=1, progress=False)
    trained = npred.train(small, store=store, jobs=1, progress=False)
    found = npred.evaluate(small, store=store, jobs=1, progress=False)
    assert isinstance(found.result, Evaluated)
    assert (data.action, trained.action, found.action) == ("run", "run", "run")
    assert data.data.X.shape == (data.result.samples, 2)
    assert trained.network([0.03, 30.0], np.zeros((21, 1)), 1.0).shape == (21, 2)
    assert PredictorId("deeponet", None) in found.result.models
    made = sources.resolved(small)
    steps = Planner(made, Store(store), "cpu").plan(nodes(made, ["evaluate"]))
    assert [step.key for step in steps] == [data.key, trained.key, found.key]
    assert npred.evaluate(small, store=store, jobs=1).action == "hit"
    assert "DeepONet" in str(found)
    assert capsys.readouterr().out == ""


def test_the_stages_are_imported_when_they_are_called():
    asked = "import sys, npred; npred.generate; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", asked], env=process_environment()).returncode == 0


@pytest.mark.slow
def test_a_notebook_generates_trains_guards_and_exports_with_one_view_a_cell(tmp_path: Path):
    pytest.importorskip("nbconvert")
    pytest.importorskip("ipykernel")
    copy = tmp_path / NOTEBOOK.name
    copy.write_text(NOTEBOOK.read_text())
    convert = [sys.executable, "-m", "nbconvert", "--to", "notebook", "--execute", copy.name, "--output", "done.ipynb"]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = process_environment(PATH=path)
    subprocess.run([sys.executable, "-c", "import matplotlib.font_manager"], check=True)  # tells of fonts once
    done = subprocess.run(convert, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    outputs = [
        [output["output_type"] for output in cell["outputs"]]
        for cell in json.loads((tmp_path / "done.ipynb").read_text())["cells"]
        if cell["cell_type"] == "code"
    ]
    assert outputs == [
        ["stream"],
        ["display_data", "stream", "execute_result"],
        *[["display_data", "stream"]] * 2,
        ["stream", "display_data"],
        ["stream"],
    ]
    assert (tmp_path / "controller" / "npred.c").is_file()
