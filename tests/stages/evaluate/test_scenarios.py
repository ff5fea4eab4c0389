"""Scenarios: the cases under other conditions, as a result, the same for every predictor."""

import math

import numpy as np
import pytest
from jobs import PLANT as NAME
from jobs import job
from known_loops import NEVER, known_loops

import npred
from npred.lab.config.conditions import starts
from npred.lab.config.results import NO_ADAPTATION, NUMERICAL, PredictorId
from npred.lab.stages.evaluate import behaviour
from npred.loop import metrics
from npred.plants import Plant
from npred.prediction.methods import RK4

PLANT = npred.plant(NAME)
TABLES = [
    {"name": "as it is"},
    {"name": "noise", "measurement": {"relative_noise": 0.02, "period": 0.05}},
    {"name": "other plant", "truth_scale": 1.03},
    {"name": "drift", "drift": {"amplitude": 0.2, "period": 3.0}, "actuator": "history"},
    {"name": "observed", "adaptation": "delay-observer", "actuator": "history", "case_D_hat": [0.4], "case_t_end": 8.0},
]


def predictors():
    """The same formula under the names of four predictors: what differs then is the loops, not the prediction."""
    names = (NUMERICAL, NO_ADAPTATION, PredictorId("deeponet", 3), PredictorId("deeponet"))
    return {name: RK4(PLANT, 21) for name in names}


def run(root, name, jobs=1, tables=TABLES):
    return behaviour.run_scenarios(job(root, name, jobs=jobs, evaluate={"scenarios": tables}), predictors())


def test_every_scenario_has_the_numerical_predictor_and_final_networks_alone(tmp_path):
    found = run(tmp_path, "one")
    assert [one.name for one in found] == [table["name"] for table in TABLES]
    for one in found:
        assert list(one.models) == [NUMERICAL, PredictorId("deeponet")]
        assert one.models[NUMERICAL] == one.models[PredictorId("deeponet")]  # the same starts, noise and delays
    cases = [one.models[NUMERICAL].radius.cases for one in found]
    assert cases == [4, 4, 4, 4, 2]  # two states times two estimates, or one


def test_threads_do_not_change_the_numbers(tmp_path):
    assert run(tmp_path, "one", jobs=1) == run(tmp_path, "two", jobs=2)


def test_a_scenario_is_what_simulate_does_under_it(tmp_path):
    one = run(tmp_path, "drift", tables=[TABLES[3]])[0].models[NUMERICAL]
    task = job(tmp_path, "same")
    begin = starts(task.config, PLANT)
    loops = npred.simulate(
        PLANT, RK4(PLANT, 21), D=lambda t: 1 + 0.2 * math.sin(2 * math.pi * t / 3), D_hat=begin.D_hat[begin.cases],
        X0=begin.X0[begin.cases], t_end=6.0, dt=0.01, adaptation=npred.DelayAdaptation(1000.0, 1.0, (0.1, 4.0)),
        actuator="history",
    )  # fmt: skip
    radii = metrics.radius(loops, PLANT.equilibrium)
    assert one.radius.worst == pytest.approx(radii.max(), rel=0.05)  # every tenth step is kept
    late = loops.t >= 5.4
    delay = 1 + 0.2 * np.sin(2 * np.pi * loops.t[late] / 3)
    assert one.D_error == pytest.approx(np.abs(loops.D_hat[:, late] - delay).max(), rel=0.05)


class Held:
    """x' = a x + u with u = 1 - 2 x: at rest at 1 / (2 - a) without a delay."""

    states, inputs, parameters = ("x",), ("u",), {"a": 1.0}
    f = lambda x, u, t, p, M: [p.a * x.x + u.u]
    kappa = lambda x, t, p, M: [1 - 2 * x.x]
    V = lambda x, t, p, M: (x.x - 1) ** 2


@pytest.mark.parametrize(("a", "lost"), [(1.0, 0), (1.1, 0), (1.5, 2)])
def test_loops_that_end_far_from_the_models_rest_are_lost(a, lost):
    """At rest at 1 / (2 - a), a little further with a delay: by more than a fifth of |X*| = 1 for a = 1.5."""
    plant, truth = Plant("held", Held), Plant("held", Held, {"a": a})
    loops = npred.simulate(plant, RK4(plant, 21), D=0.01, D_hat=0.01, X0=[[0.5], [2.0]], t_end=40.0, truth=truth)
    does = behaviour.behaviour(plant, loops, 0.01)
    assert does.radius.median == pytest.approx(1 / (2 - a) - 1, rel=0.1, abs=1e-6)
    assert does.far == lost and does.D_error == 0 and does.radius.count == (2 if a == 1 else 0)


def test_loops_that_diverge_are_lost():
    plant = Plant("held", Held)
    loops = npred.simulate(plant, RK4(plant, 21), D=3.0, D_hat=0.0, X0=[[0.5], [1.0]], t_end=60.0, u0=[-1.0])
    does = behaviour.behaviour(plant, loops, 3.0)
    assert does.far == 1 and does.radius.converged == 0.5 and does.D_error == 3.0
    assert does.json_object()["radius"]["cases"] == 2


def test_what_loops_do_is_medians_over_the_cases():
    loops = known_loops([20, 30, 80, 7, NEVER], [0.001, 0.004, 0.006, 0.003, 1.0])
    does = behaviour.behaviour(npred.plant("scalar"), loops, 0.25)
    assert (does.radius.median, does.radius.worst, does.radius.count) == (0.004, 1.0, 4)
    assert (does.settle_time, does.far, does.D_error) == (30.0, 1, 0.25)  # D_hat is 0 throughout
