"""The loops that a table of the pipeline file asks for: those of simulate with the same settings, and their starts."""

import dataclasses
import math
import types

import numpy as np
import pytest
from jobs import tables
from slow_cart import Cart

import npred
from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.config import Evaluate, LoopTable
from npred.lab.config.conditions import Condition, box, starts
from npred.prediction.methods import RK4

PLANT = npred.plant("activator_repressor")
START = {"X0": [[0.03, 30.0], [0.1, 20.0]], "t_end": 3.0}
OTHER = npred.plant("activator_repressor", Ka=0.042)
CASES = {
    "nothing": ({}, {}),
    "history": ({"actuator": "history"}, {"actuator": "history"}),
    "sensors": (
        {"measurement": {"relative_noise": 0.02, "period": 0.05, "jitter": 0.1, "delay": 0.02, "drop": 0.1}},
        {"measurement": npred.Measurement(0.0, 0.05, 0.1, 0.02, 0.1, relative_noise=0.02, seed=7)},
    ),
    "errors": (
        {"measurement": {"noise": [0.001, 0.5], "bias": [0.0, 0.1], "resolution": 0.002}},
        {"measurement": npred.Measurement(noise=[0.001, 0.5], bias=[0.0, 0.1], resolution=0.002, seed=7)},
    ),
    "input bounds": ({"input_bounds": [[0.0, 0.0102]]}, {"input_bounds": [(0.0, 0.0102)]}),
    "input before": ({"u0": [0.02]}, {"u0": [0.02]}),
    "clock": (
        {"timing": {"jitter": 0.2, "lost": 0.05}, "actuator": "history"},
        {"timing": npred.Timing(jitter=0.2, lost=0.05, seed=7), "actuator": "history"},
    ),
    "observer": (
        {"observer": {"kind": "ekf"}, "actuator": "history"},
        {"observer": npred.observers.EKF(PLANT), "actuator": "history"},
    ),
    "truth": ({"truth": {"Ka": 0.042}}, {"truth": OTHER}),
    "disturbance": (
        {"disturbance": {"amplitude": 0.01, "omega": 0.7}}, {"disturbance": lambda t: 0.01 * math.sin(0.7 * t)},
    ),
}  # fmt: skip


def run(table, **changes):
    settings = START | {"D": 1.0, "D_hat": 1.2, "seed": 7} | changes
    return Condition(table, **settings).loops(PLANT, RK4(PLANT, 21))


@pytest.mark.parametrize("name", CASES)
def test_a_table_runs_as_the_same_settings_in_python(name):
    keys, arguments = CASES[name]
    loops = run(Evaluate.model_validate({"dt": 0.01} | keys))
    adaptation = npred.DelayAdaptation(1000.0, 1.0, (0.1, 4.0))
    direct = npred.simulate(
        PLANT, RK4(PLANT, 21), D=1.0, D_hat=1.2, dt=0.01, adaptation=adaptation, **START, **arguments
    )
    np.testing.assert_array_equal(loops.X, direct.X)
    assert name == "nothing" or not np.array_equal(loops.X, run(Evaluate(dt=0.01)).X)


CART = npred.plant(Cart)
RARE = {"actuator": "history", "timing": {}, "measurement": {"noise": 0.05, "period": 0.1, "delay": 0.06, "drop": 0.5}}
KEYS = {  # of a loop in a pipeline: a value, and a table in which it makes another U
    "dt": (0.02, {}), "adaptation": ("delay-observer", {}), "gamma": (50.0, {}), "b": (50.0, {"gamma": 5.0}),
    "bounds": ((0.199, 0.301), {"gamma": 500.0}), "input_bounds": ([[-0.2, 0.2]], {}), "u0": ([0.5], {}),
    "actuator": ("history", {}), "observer": ({}, RARE), "watchdog": ({"after": 0.1, "then": "zero"}, RARE),
    "safety": ({}, {}), "outlier_limit": (0.001, RARE), "max_sample_age": (0.06, RARE | {"timing": {"jitter": 0.4}}),
    "measurement": ({"noise": 0.01}, {}), "truth": ({"drag": 0.4}, {}), "truth_scale": (1.5, {}),
    "disturbance": ({"amplitude": 0.1}, {}), "setpoints": ({"aim": {"at": [0.5], "to": [0.2]}}, {}),
    "timing": ({"lost": 0.5}, {"actuator": "history"}), "integrator": ("euler", {}),
}  # fmt: skip


def test_every_key_of_a_loop_is_tried():
    assert KEYS.keys() | {"nx", "predictor", "t_end"} == LoopTable.model_fields.keys()  # those of the predictor aside
    python = {"plant", "predictor", "D", "D_hat", "X0", "history_length"}
    assert {field.name for field in dataclasses.fields(npred.Loop)} - python <= KEYS.keys()


@pytest.mark.parametrize("key", KEYS)
def test_a_key_reaches_the_loop_that_is_run(key):
    """With it U is another one, in [evaluate] and in a scenario alike."""
    value, table = KEYS[key]
    table = {"dt": 0.01, "D": 0.2, "gamma": 5.0, "bounds": [0.05, 0.8]} | table
    plain = Evaluate.model_validate(table | {"scenarios": [{"name": "a", key: value}]})
    loops = [plain, Evaluate.model_validate(table | {key: value}), plain.under(plain.scenarios[0])]
    start = {"X0": np.array([[0.0, 0.1], [0.1, 0.1]]), "D": 0.2, "D_hat": 0.3, "t_end": 1.6, "seed": 7}
    without, *both = (Condition(one, **start).loops(CART, RK4(CART, 11)).U for one in loops)
    np.testing.assert_array_equal(*both)
    assert without.shape != both[0].shape or not np.array_equal(without, both[0])


def test_a_part_of_a_batch_has_the_noise_that_it_has_in_the_whole():
    table = Evaluate.model_validate({"dt": 0.01, "measurement": {"relative_noise": 0.05}})
    whole = run(table)
    condition = Condition(table, **START, D=np.ones(2), D_hat=np.full(2, 1.2), seed=7)
    part = condition.part(slice(1, 2)).loops(PLANT, RK4(PLANT, 21))
    np.testing.assert_array_equal(part.X[0], whole.X[1])
    assert (condition.steps, condition.part(slice(1, 2)).steps) == (602, 301)
    assert not np.array_equal(run(table, X0=START["X0"][1:]).X[0], whole.X[1])


def test_without_adaptation_the_estimate_is_held():
    assert (run(Evaluate(dt=0.01), adapts=False).D_hat == 1.2).all()


def test_a_parameter_that_the_plant_does_not_have_is_refused():
    with pytest.raises(ConfigError, match=r"expected parameters .* got 'k'"):
        run(Evaluate(truth={"k": 1.0}))


def test_starts_are_figure_1_then_cases_then_the_map():
    tables_ = tables(evaluate={"map_D": [0.5, 1.5], "map_D_hat": [0.6, 0.7, 0.8]})
    begin = starts(config.parse(tables_ | {"seed": 0}, "tests"), PLANT)
    assert begin.D_hat.tolist() == [2.0, 0.8, 1.2, 0.8, 1.2, 0.6, 0.7, 0.8, 0.6, 0.7, 0.8]
    assert begin.D.tolist() == [1.0] * 5 + [0.5] * 3 + [1.5] * 3
    np.testing.assert_array_equal(begin.X0[begin.map], np.tile([0.03, 30.0], (6, 1)))
    np.testing.assert_array_equal(begin.X0[1], begin.X0[2])
    assert (begin.X0[begin.cases, 1] >= 25).all() and (begin.X0[begin.cases, 1] <= 35).all()


def test_experiments_start_in_the_plants_box_and_data_in_the_pipelines():
    pipeline = config.parse({"plant": PLANT.name, "generate": {"box": {"x1": [0.5, 0.7], "x2": [3.0, 4.0]}}}, "tests")
    boxless = types.SimpleNamespace(states=PLANT.states, box={"x2": (1.0, 2.0)})
    np.testing.assert_array_equal(box(boxless, pipeline.generate), [[0.5, 0.7], [1.0, 2.0]])
    np.testing.assert_array_equal(box(boxless, pipeline.generate, data=True), [[0.5, 0.7], [3.0, 4.0]])
