"""`npred init`: a plant and a pipeline to start from, sound as written, and nothing overwritten."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from npred import plants
from npred.cli import app
from npred.diagnosis import check
from npred.lab import config
from npred.lab.scheduler.pipeline_fit import require

SMALL = (
    *("generate.samples=200", "generate.rollouts=4", "generate.t_end=4", "train.deeponet.epochs=1"),
    *("train.fno.epochs=1", "evaluate.t_end=1", "evaluate.case_t_end=1", "evaluate.case_states=1"),
)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("NPRED_STORE", raising=False)


def call(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


def test_what_is_written_is_sound():
    done = json.loads(call("init", "two_tanks", "--json").stdout)
    assert done == {"plant": "two_tanks.py:TwoTanks", "files": ["two_tanks.py", "two_tanks.toml"]}
    pipeline = config.load(Path("two_tanks.toml"))
    assert pipeline.plant == done["plant"]
    plant = plants.resolve(pipeline.plant)
    require(plant, pipeline, ("generate", "train", "evaluate", "bench"))
    assert {answer.verdict for answer in check(plant)} == {"yes"}
    assert not any("CLASS" in Path(name).read_text() or "NAME" in Path(name).read_text() for name in done["files"])


def test_people_are_told_what_comes_next():
    assert "npred plants check my_plant.py:MyPlant, then npred run my_plant.toml" in call("init", "my_plant").stdout


@pytest.mark.parametrize("there", ["my_plant.py", "my_plant.toml"])
def test_nothing_is_overwritten(there):
    Path(there).write_text("mine")
    result = call("init", "my_plant")
    assert result.exit_code == 2
    assert f"expected no {there} here" in result.stderr
    assert [path.read_text() for path in Path().iterdir()] == ["mine"]


@pytest.mark.parametrize("name", ["My_plant", "my-plant", "class", "none", "true", "_", "../plant", "my_plant.py", ""])
def test_a_name_that_is_none_is_told(name):
    result = call("init", name)
    assert result.exit_code == 2
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    "source", ["scalar", "cart_pole", "unicycle", "unicycle_time_delay", "planar_arm2", "activator_repressor"]
)
def test_a_copy_of_a_plant_is_the_plant(source: str):
    spec = json.loads(call("init", "my_copy", "--from", source, "--json").stdout)["plant"]
    assert config.load(Path("my_copy.toml")).files == ["my_copy.py"]  # none that lies beside npred's pipeline
    pipeline, copy, plant = config.load(Path("my_copy.toml")), plants.resolve(spec), plants.resolve(source)
    assert (pipeline.name, pipeline.plant) == ("my_copy", "my_copy.py:MyCopy")
    require(copy, pipeline, ("generate", "train", "evaluate", "bench"))
    x, u = np.array([plant.box.get(name, (0.1, 0.3))[1] for name in plant.states]), np.full(plant.m, 0.7)
    assert np.array_equal(copy.f(x, u, 0.2), plant.f(x, u, 0.2))
    assert np.array_equal(copy.kappa(x, 0.2), plant.kappa(x, 0.2))
    assert not re.search(rf"\bclass {plants.resolve(source).declaration.__name__}\b", Path("my_copy.py").read_text())


def test_a_plant_without_a_pipeline_gets_one_that_fits():
    call("init", "arm", "--from", "planar_arm3")
    pipeline, plant = config.load(Path("arm.toml")), plants.resolve("arm.py:Arm")
    require(plant, pipeline, ("generate", "train", "evaluate", "bench"))
    assert pipeline.train.deeponet.anchor == pipeline.train.fno.anchor == "initial"
    call("init", "mine")
    assert call("init", "copy", "--from", "mine.py:Mine").exit_code == 0
    assert plants.resolve("copy.py:Copy").parameters == plants.resolve("mine.py:Mine").parameters


def test_a_plant_to_copy_that_there_is_none_of():
    result = call("init", "arm", "--from", "planar_arm9")
    assert result.exit_code == 2
    assert "did you mean planar_arm" in result.stderr
    assert list(Path().iterdir()) == []


@pytest.mark.slow
def test_what_is_written_runs():
    """Up to evaluate; bench, which takes its time whatever the plant, is planned."""
    call("init", "my_plant")
    settings = ["--jobs", "1", "--json", *(word for key in SMALL for word in ("--set", key))]
    result = call("evaluate", "my_plant.toml", *settings)
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["result"]["plant"] == "MyPlant"
    planned = json.loads(call("run", "my_plant.toml", "--dry-run", *settings).stdout)["stages"]
    assert [row["action"] for row in planned] == [*["hit"] * 4, "run", "run"]
