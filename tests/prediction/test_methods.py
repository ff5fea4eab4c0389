"""Numerical methods by name: of npred, of an installed package, of a user's file; from keys to a bench."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import settings_of
from jobs import job, tables
from typer.testing import CliRunner

import npred
from npred import plants
from npred.base import grid
from npred.base.errors import ConfigError
from npred.base.registry import METHODS
from npred.cli import app
from npred.lab import config
from npred.lab.scheduler.plan import Node, Planner
from npred.lab.stages.bench import candidates
from npred.lab.stages.generate import generate
from npred.lab.store import Store
from npred.lab.training.data.dataset import Dataset
from npred.loop.closed_loop import simulate
from npred.prediction import methods as predictors
from npred.prediction.methods import OneStep

PLANT = plants.resolve("scalar")
RALSTON = """
from npred.prediction.methods.base import OneStep

class Ralston(OneStep):
    name, order = "ralston", 2

    @staticmethod
    def step(f, x, u0, um, u1, t, h):
        k1 = f(x, u0, t)
        k2 = f(x + 2 * h / 3 * k1, u0 + 2 * (u1 - u0) / 3, t + 2 * h / 3)
        return x + h / 4 * (k1 + 3 * k2)
"""


@pytest.fixture
def ralston(tmp_path: Path) -> str:
    """A method's file; its name for a pipeline."""
    (tmp_path / "my_method.py").write_text(RALSTON)
    return f"{tmp_path / 'my_method.py'}:Ralston"


def question(stage: str, **changed: dict) -> dict:
    node = Node(stage, None, ())
    return settings_of(node, config.parse(tables(**changed), "tests"))


@pytest.mark.parametrize(("name", "count"), [("euler", 1), ("heun", 2), ("rk4", 4)])
def test_evaluations_of_f_are_counted_from_the_formula(name, count):
    method = predictors.method(name)
    assert issubclass(method, OneStep) and method.evaluations() == count


def test_a_method_of_a_file_predicts_and_integrates(ralston):
    """On a linear plant all methods of order 2 with two stages are one polynomial of h f_P; here u is constant."""
    mine = npred.predictor(PLANT, ralston, 41)
    X, u = [1.0], np.full((41, 1), 0.3)
    assert abs(mine(X, u, 0.5) - npred.predictor(PLANT, "rk4", 41)(X, u, 0.5)).max() < 1e-4
    settings = {"D": 0.3, "D_hat": 0.3, "X0": [0.5], "t_end": 1.0, "dt": 0.01}
    loops = [simulate(PLANT, mine, integrator=name, **settings) for name in (ralston, "heun")]
    np.testing.assert_allclose(loops[0].X, loops[1].X, atol=1e-5)


def test_data_are_made_by_a_method_of_a_file(ralston, tmp_path):
    run = job(tmp_path, "data", generate={"predictor": ralston, "rollouts": 3, "samples": 30})
    generate.run(run)
    rows = Dataset.read(run.folder / "data.h5")
    P = predictors.numerical(ralston, run.plant)(rows.X, rows.u, rows.D_hat)
    np.testing.assert_array_equal(rows.P, P)


@pytest.mark.slow
def test_a_pipeline_runs_with_a_method_of_a_file_and_times_it(ralston, pipeline):
    settings = ["train.models=['deeponet']", "train.deeponet={epochs=1, width=8}", "bench.runtimes=['fused']"]
    settings += ["bench.calls=12", "bench.dx=[0.1, 0.05]"]
    settings += [f"generate.predictor={ralston}", f"evaluate.predictor={ralston}", "evaluate.case_states=2"]
    arguments = [*(word for key in settings for word in ("--set", key)), "--store", str(pipeline.parent / "store")]
    done = CliRunner().invoke(app, ["run", str(pipeline), "--json", *arguments])
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    result = answer["result"]
    assert result["models"]["numerical"]["mse"] == 0
    grids = {row["dx"] for row in result["rows"] if (row["predictor"], row["runtime"]) == ("Ralston", "compiled")}
    assert {0.1, 0.05} <= grids
    assert "Ralston" in [row["predictor"] for row in result["crossover"][0]["numerical"]]
    assert "Ralston" in Path(answer["report"]).read_text()


def test_a_method_of_a_file_enters_keys_by_what_it_holds(ralston):
    changes = {name: {"predictor": ralston} for name in ("generate", "evaluate")}
    for stage in ("generate", "evaluate"):
        plain, mine = question(stage), question(stage, **changes)
        assert plain[stage]["predictor"] == "rk4" and mine[stage]["predictor"]["name"] == "Ralston"
        assert mine[stage] | {"predictor": "rk4"} == plain[stage]
    assert question("bench", **changes)["methods"] == [*question("bench")["methods"], mine["evaluate"]["predictor"]]
    path = Path(ralston.partition(":")[0])
    moved = path.rename(path.with_name("moved.py"))
    elsewhere = {name: {"predictor": f"{moved}:Ralston"} for name in ("generate", "evaluate")}
    assert question("evaluate", **elsewhere) == mine
    moved.write_text(RALSTON + "# another\n")
    assert question("evaluate", **elsewhere) == mine
    moved.write_text(RALSTON.replace("h / 4", "h / 5") + "# another\n")
    assert question("evaluate", **elsewhere) != mine


def test_the_times_of_a_bench_are_of_the_methods_that_there_are(monkeypatch):
    """A method that is built in later is timed too: a result without it is not the answer."""
    before = question("bench")
    assert before["methods"] == [*METHODS.builtin]
    monkeypatch.setitem(METHODS.builtin, "euler_again", METHODS.builtin["euler"])
    assert question("bench")["methods"] == [*before["methods"], "euler_again"]


def test_the_times_of_a_bench_are_of_the_baselines_as_their_files_are(tmp_path: Path):
    file = tmp_path / "plain.py"
    file.write_text("class Plain: pass\n")
    plain, named = question("bench"), question("bench", bench={"baselines": [f"{file}:Plain"]})
    assert plain["bench"]["baselines"] == [] and named["bench"]["baselines"][0]["name"] == "Plain"
    file.write_text("class Plain: speed = 1\n")
    assert question("bench", bench={"baselines": [f"{file}:Plain"]}) != named
    with pytest.raises(ConfigError, match=r"bench.baselines.*expected a class of a file as my_file.py:Name, got 'rk4'"):
        question("bench", bench={"baselines": ["rk4"]})


def test_a_method_of_a_package_has_a_name(package):
    package("ralston = shed_of_tanks:Ralston", RALSTON, "npred.predictors")
    x = grid.nodes(21)[:, None]
    P = npred.predictor(PLANT, "ralston", 21)([1.0], x, 0.5)
    np.testing.assert_allclose(P, npred.predictor(PLANT, "heun", 21)([1.0], x, 0.5), atol=1e-4)
    asked = question("generate", generate={"predictor": "ralston"})["generate"]["predictor"]
    assert asked == {
        "name": "ralston", "target": "shed_of_tanks:Ralston", "package": "shed-of-tanks", "version": "1.0",
    }  # fmt: skip
    assert "ralston" in candidates.one_step_methods(config.parse(tables(), "tests"), PLANT)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("(OneStep)", "", "expected a subclass of npred.Predictor"),
        ("def step", "def stride", "expected a class with step, got none"),
        ("f(x, u0, t)", "f(x, u0, q)", r"step \(my_method.py:\d+\) failed at my_method.py:9: NameError"),
        ("x + h / 4 * (k1 + 3 * k2)", "0.0", r"expected to evaluate f and to return the state, shape \(n,\), got \(\)"),
        ("class Ralston", "class Other", "expected a class Ralston, found Other"),
    ],
)
def test_a_file_that_is_no_method_is_refused_in_one_line_before_a_run(ralston, old, new, message):
    Path(ralston.partition(":")[0]).write_text(RALSTON.replace(old, new))
    pipeline = config.parse(tables(generate={"predictor": ralston}), "tests")
    with pytest.raises(ConfigError, match=message) as caught:
        Planner(pipeline, Store(Path()), "cpu").check([Node("generate", None, ())])
    assert "\n" not in str(caught.value)


def test_an_unknown_method_is_refused_where_the_pipeline_is_read():
    with pytest.raises(ConfigError, match=r"generate.predictor: expected euler, .*, got 'rk5'; did you mean rk4\?"):
        config.parse(tables(generate={"predictor": "rk5"}), "tests")
