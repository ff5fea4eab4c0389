"""The tank: its delay is the pipe's, and from the first command on the loop is the one without delay."""

from pathlib import Path

import numpy as np
import plant_claims
import pytest
from scipy.integrate import solve_ivp

import npred
from npred import diagnosis, plants
from npred.lab import config
from npred.lab.scheduler import pipeline_fit
from npred.prediction.methods import RK4

PLANT = plants.resolve("transport_tank")
START = np.array([2.8, 25.0])


def test_dynamics_law_and_delay_are_those_of_the_docstring():
    """Typed again in other terms: the feed a v, the minutes A h / (a v) of it in the tank."""
    for h, T in plant_claims.box(PLANT, 20):
        feed = 0.06 * 15 * np.sqrt(4 - h)
        stay = 2 * h / feed
        X, u = np.array([h, T]), np.array([-5.0])
        np.testing.assert_allclose(PLANT.f(X, u), [(feed - 0.9 * np.sqrt(h)) / 2, (-5 - T) / stay + 0.5 * T])
        np.testing.assert_allclose(PLANT.delay(X), 40 * 0.06 / feed)
        closed = PLANT.f(X, PLANT.kappa(X))
        np.testing.assert_allclose(closed[1], -0.5 * (T - 20), atol=1e-12)
        u = 2 * ((h - 2) * closed[0] + (T - 20) * closed[1])
        assert u < 0, "V falls"


def test_it_rests_at_half_the_head_and_runs_away_without_control():
    np.testing.assert_allclose(PLANT.equilibrium, [2.0, 20.0])
    open_loop, _ = PLANT.jacobians(PLANT.equilibrium, PLANT.u_equilibrium)
    assert np.linalg.eigvals(open_loop).max() > 0.1


def test_derivatives_equal_differences():
    plant_claims.derivatives_equal_differences(PLANT)


def test_commands_never_overtake_each_other_from_the_box():
    answers = {answer.check: answer for answer in diagnosis.check(PLANT)}
    assert answers["feasibility"].verdict == "yes" and diagnosis.settled(list(answers.values()))
    loops = npred.simulate(PLANT, RK4(PLANT, 51), X0=plant_claims.box(PLANT, 20), t_end=40.0, dt=0.02, u0="equilibrium")
    assert (loops.infeasible == -1).all()
    assert np.abs(loops.X[:, -1] - PLANT.equilibrium).max() < 1e-3


def test_from_the_first_command_on_the_loop_is_the_one_without_delay():
    held = lambda t, X: PLANT.f(X, PLANT.u_equilibrium)

    def arrives(t, X):  # the command of t = 0 acts when t = D(X(t))
        return t - PLANT.delay(X)

    arrives.terminal = True
    before = solve_ivp(held, (0, 5), START, events=arrives, rtol=1e-11, atol=1e-12)
    times = np.arange(4.0, 15.0, 1.0)
    span = (before.t[-1], times[-1])
    after = solve_ivp(lambda t, X: PLANT.f(X, PLANT.kappa(X)), span, before.y[:, -1], t_eval=times, rtol=1e-11)
    exact = after.y.T
    errors, steps = [], [0.04, 0.02, 0.01]
    for dt in steps:
        loop = npred.simulate(PLANT, RK4(PLANT, 101), X0=START, t_end=15.0, dt=dt, u0="equilibrium")
        errors.append(np.abs(loop.X[np.rint(times / dt).astype(int)] - exact).max())
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.3)
    assert errors[-1] < 0.05  # of 30 K


def test_its_pipeline_fits():
    pipeline = config.load(Path(__file__).parents[3] / "pipeline" / "state_delay.toml")
    pipeline_fit.require(plants.resolve(pipeline.plant), pipeline, ("generate", "train", "evaluate", "bench"))
