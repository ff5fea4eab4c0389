"""A scenario of the pipeline file as a condition: its delay, and the parameters of the simulated plant."""

from dataclasses import replace

import numpy as np
import pytest

import npred
from npred.lab import config
from npred.lab.config import Evaluate, Scenario, conditions

PLANT = npred.plant("activator_repressor")
RK4 = npred.predictor(PLANT, "rk4", 11)


def test_the_delay_of_a_scenario():
    table = Evaluate(D=1.0)
    drift = conditions.true_delay(
        table, Scenario.model_validate({"name": "a", "drift": {"amplitude": 0.3, "period": 60.0}})
    )
    jump = conditions.true_delay(table, Scenario.model_validate({"name": "a", "jump": {"to": 1.5, "at": 30.0}}))
    assert callable(drift) and callable(jump)
    assert [drift(t) for t in (0.0, 15.0, 45.0)] == pytest.approx([1.0, 1.3, 0.7])
    assert [jump(t) for t in (0.0, 29.99, 30.0, 60.0)] == [1.0, 1.0, 1.5, 1.5]
    assert conditions.true_delay(table, Scenario(name="a")) == 1.0


def test_scaled_parameters_are_those_of_the_truth():
    pipeline = config.parse({"plant": PLANT.name, "evaluate": {"X0": [0.03, 30.0], "truth": {"Ka": 0.05}}}, "tests")
    scaled, given = (
        conditions.under(PLANT, pipeline, Scenario.model_validate({"name": "a"} | key)).loop(PLANT, RK4).real.parameters
        for key in ({"truth_scale": 1.1}, {"truth": {"Kb": 0.005}})
    )
    assert scaled == {name: pytest.approx(1.1 * value) for name, value in (PLANT.parameters | {"Ka": 0.05}).items()}
    assert given == PLANT.parameters | {"Kb": 0.005}


def test_a_scenario_may_have_a_clock():
    """Its loops are those of npred.simulate with the clock, whatever part of the batch they are run in."""
    evaluate = {"X0": [0.1], "D": 0.2, "case_states": 3, "case_D_hat": [0.2], "adaptation": "frozen", "dt": 0.01}
    pipeline = config.parse({"plant": "scalar", "evaluate": evaluate | {"case_t_end": 2.0, "t_end": 2.0}}, "tests")
    clock = {"jitter": 0.3, "lost": 0.2}
    scenario = Scenario.model_validate(
        {"name": "a", "actuator": "history", "timing": clock, "measurement": {"delay": 0.05}}
    )
    plant = npred.plant("scalar")
    predictor = npred.predictor(plant, "rk4", nx=11)
    condition = conditions.under(plant, pipeline, scenario)
    condition = replace(condition, D=np.full(3, condition.D))
    whole, part = condition.loops(plant, predictor), condition.part(slice(1, 3)).loops(plant, predictor)
    alone = npred.simulate(
        plant, predictor, D=0.2, D_hat=0.2, X0=condition.X0, t_end=2.0, dt=0.01, actuator="history",
        timing=npred.Timing(**clock, seed=condition.seed),
        measurement=npred.Measurement(delay=0.05, seed=condition.seed),
    )  # fmt: skip
    assert (whole.X == alone.X).all() and (whole.X[1:] == part.X).all()
    assert whole.clock is not None and whole.clock.lost.min() > 10


def test_a_scenario_may_observe_the_state():
    """The chemostat from one of its states, which is what the samples then are."""
    evaluate = {"X0": [2.5, 2.2], "D": 0.5, "case_states": 2, "case_D_hat": [0.5], "adaptation": "frozen", "dt": 0.01}
    pipeline = config.parse({"plant": "chemostat", "evaluate": evaluate | {"case_t_end": 20.0, "t_end": 20.0}}, "tests")
    observer = {"kind": "ekf", "outputs": ["S"], "offset": True}
    scenario = {"name": "a", "actuator": "history", "observer": observer, "measurement": {"resolution": [0.01]}}
    plant = npred.plant("chemostat")
    condition = conditions.under(plant, pipeline, Scenario.model_validate(scenario))
    run = condition.loops(plant, npred.predictor(plant, "rk4", nx=11))
    assert run.clock is not None and np.abs(run.clock.X_hat - run.X)[:, -1].max() < 0.03
    assert np.abs(run.X[:, -1] - plant.equilibrium).max() < 0.05
