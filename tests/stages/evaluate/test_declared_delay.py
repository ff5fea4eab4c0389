"""A plant that declares its delay, through all stages on a tiny problem."""

import json
from dataclasses import replace

import numpy as np
import pytest
from jobs import SMALL, job

from npred import plants
from npred.lab.config.conditions import starts
from npred.lab.config.results import NUMERICAL, Benched, Evaluated, PredictorId
from npred.lab.report import figures
from npred.lab.stages.bench import bench
from npred.lab.stages.evaluate import behaviour, evaluate
from npred.lab.stages.generate import generate
from npred.lab.stages.report import report
from npred.lab.stages.train import train
from npred.lab.training.data.dataset import Dataset
from npred.prediction.methods import RK4

TANK = "transport_tank"
TABLES = {
    "plant": TANK,
    "generate": {"u0": "equilibrium", "bounds": (0.1, 4.0), "dt": 0.02, "t_end": 10.0},
    "evaluate": {"X0": [2.8, 25.0], "u0": "equilibrium", "dt": 0.02, "t_end": 10.0, "case_t_end": 12.0,
                 "case_D_hat": [0.3, 0.5, 1.0, 1.5, 2.0],
                 "scenarios": [{"name": "noise", "measurement": {"relative_noise": 0.01}},
                               {"name": "pipe", "truth": {"L": 42.0}}]},
}  # fmt: skip


@pytest.fixture(scope="module")
def stages(tmp_path_factory):
    """The jobs of all stages by name, run one after the other."""
    root = tmp_path_factory.mktemp("declared")
    jobs, inputs = {}, {}
    for name, run in (
        ("generate", generate.run), ("deeponet", train.run), ("fno", train.run), ("evaluate", evaluate.run),
        ("bench", bench.run), ("report", report.run),
    ):  # fmt: skip
        model = name if name in SMALL["train"] else None
        jobs[name] = job(root, name, inputs=dict(inputs), model=model, **TABLES)
        result = run(jobs[name])
        (jobs[name].folder / "result.json").write_text(json.dumps(result.json_object()))
        inputs[name] = jobs[name].folder
        if model:
            (jobs[name].folder / "metrics.jsonl").touch()
    return jobs


def test_data_hold_the_declared_delay(stages):
    data, plant = Dataset.read(stages["generate"].folder / "data.h5"), plants.resolve(TANK)
    np.testing.assert_allclose(data.D_hat, plant.delay(data.X), rtol=1e-12)


def test_cases_are_the_states_alone_and_nothing_runs_without_adaptation(stages):
    result = Evaluated.read(stages["evaluate"].folder)
    assert [c.name for c in result.models] == ["numerical", "deeponet@1", "deeponet", "fno"]
    assert result.models[NUMERICAL].radius.cases == 2 and result.models[NUMERICAL].map is None
    begin = starts(stages["evaluate"].config, stages["evaluate"].plant)
    assert begin.repeats == 1 and len(begin.X0) == 3


def test_the_error_in_the_loop_has_no_delay_and_the_exact_predictor_hardly_any(stages):
    result = Evaluated.read(stages["evaluate"].folder)
    assert (result.in_loop.D, result.in_loop.start, result.in_loop.loops) == (None, None, 3)
    exact, network = (result.models[c].in_loop for c in (NUMERICAL, PredictorId("deeponet")))
    assert exact < 0.02 < network


def test_scenarios_have_no_error_of_an_estimate(stages):
    result = Evaluated.read(stages["evaluate"].folder)
    assert [one.name for one in result.scenarios] == ["noise", "pipe"]
    assert all(does.D_error is None for one in result.scenarios for does in one.models.values())
    *_, table = tables = evaluate.details(result).split("\n\n")
    assert table.splitlines()[1].split()[:2] == ["scenario", "predictor"] and len(table.splitlines()) == 8
    assert "|D̂ − D|" not in table
    others = evaluate.details(result.model_copy(update={"scenarios": []})).split("\n\n")
    assert others == tables[:-1]


def test_figures_show_the_delay_where_others_show_the_estimate(stages):
    task = stages["evaluate"]
    result = Evaluated.read(task.folder)
    data = figures.EvaluationData.read(task.folder, task.plant, task.config.evaluate, result)
    figure = figures.figure1(data)
    assert "delay D(X, t) (min)" in [panel.title for panel in figure.panels]
    assert "with the delay that the plant declares" in figure.caption and "D̂(0)" not in figure.caption
    conditions = figures.scenarios(task.plant, result.scenarios)
    assert conditions is not None
    assert [panel.title for panel in conditions.panels] == ["worst radius", "settles after (min)"]


def test_the_page_says_so(stages):
    page = (stages["report"].folder / report.NAME).read_text()
    assert "a delay that the plant declares" in page and 'id="scenarios"' in page
    for absent in ("unknown to the controller", "map, of", "Errors by kind of row", "|D̂ − D|", "D̂ at its end"):
        assert absent not in page
    assert "D at its end" in page and "X(σ(t))" in page
    assert Benched.read(stages["bench"].folder).rows


def test_loops_that_end_are_reported_once(stages, tmp_path):
    inputs = {name: stages[name].folder for name in ("generate", "deeponet", "fno")}
    task = job(tmp_path, "evaluate", inputs=inputs, **TABLES)
    begin = starts(task.config, task.plant)
    numerical, part = RK4(task.plant, 21), slice(0, 3)
    loops = evaluate._loops(task, task.config.evaluate, NUMERICAL, numerical, begin, part, lambda count: None)
    behaviour.warn_of_overtaken(task.progress, {NUMERICAL: behaviour.overtaken(loops)})
    assert task.progress.notes == []
    ended = replace(
        loops, infeasible=np.array([-1, 30, 20]), margin=np.array([np.nan, -0.3, -0.25]),
        breach=np.array([[np.nan, np.nan], [1.0, 2.0], [3.0, 4.0]]),
    )  # fmt: skip
    each = {NUMERICAL: loops, PredictorId("deeponet"): ended, PredictorId("fno"): ended}
    behaviour.warn_of_overtaken(task.progress, {name: behaviour.overtaken(run) for name, run in each.items()})
    (line,) = task.progress.notes
    assert (
        "count as far from rest: 2 of DeepONet, 2 of FNO; first at control step 20, h = 3, T = 4: 1 - D_X f - D_t ="
        in line
    )


GROWING = """
class Growing:
    states, inputs, parameters, box = ("x",), ("u",), {"c": 1.0}, {"x": (0.3, 0.3)}

    def f(x, u, t, p, M):
        return [x.x + u.u]

    def kappa(x, t, p, M):
        return [-2 * x.x]

    def V(x, t, p, M):
        return x.x**2

    def delay(x, t, p, M):
        return p.c * x.x**2
"""


def test_loops_of_a_scenario_that_end_are_reported_with_its_name(tmp_path):
    """x grows until the first command arrives: with c = 4 that never does, for the delay grows faster than time."""
    (tmp_path / "growing.py").write_text(GROWING)
    tables = [{"name": "as it is"}, {"name": "4 x", "truth": {"c": 4.0}}]
    task = job(tmp_path, "evaluate", plant=f"{tmp_path}/growing.py:Growing",
               generate={"D": 1.0}, evaluate={"X0": [0.3], "case_t_end": 20.0, "scenarios": tables})  # fmt: skip
    usual, slow = behaviour.run_scenarios(task, {NUMERICAL: RK4(task.plant, 21)})
    assert [one.models[NUMERICAL].overtaking for one in (usual, slow)] == [0, 2]
    assert [one.models[NUMERICAL].far for one in (usual, slow)] == [0, 2]
    line = task.progress.notes[-1]
    assert line.startswith(
        'in the scenario "4 x" loops in which commands would overtake each other count as far from rest: 2 of '
    )
    assert float(line.partition("D_t = ")[2].partition(",")[0]) <= 0  # of the plant that is simulated
    assert sum("overtake" in note for note in task.progress.notes) == 1
