"""Loops with a delay that varies: against a DDE over three decades of dt, and against the loop without delay."""

import numpy as np
import pytest
import varying_delays
from varying_delays import InSpace, InTime

import npred
from npred import plants
from npred.predictors import RK4

X0 = (0.5, 0.5, 0.5)
IN_TIME = plants.resolve("unicycle_time_delay")
IN_SPACE = varying_delays.with_delay(lambda x, t, p, M: x.x**2 + x.y**2)
STEPS = [0.1, 0.02, 0.01, 0.005, 0.001, 0.0001]


@pytest.mark.parametrize(
    ("plant", "robot", "nodes"),
    [(IN_TIME, InTime, lambda dt: 101), (IN_SPACE, InSpace, lambda dt: max(11, 1 + round(0.25 / dt)))],
    ids=["time", "state"],
)
def test_the_loop_is_that_of_the_differential_equation(plant, robot, nodes):
    """Of first order in dt, over three decades; where D depends on the state the nodes follow dt, see below."""
    times = np.array([1.0, 1.1, 1.2])
    exact, errors = varying_delays.predictor_feedback(robot, X0, times), []
    for dt in STEPS:
        loop = npred.simulate(plant, RK4(plant, nodes(dt)), X0=X0, t_end=1.2, dt=dt)
        errors.append(np.abs(loop.X[np.rint(times / dt).astype(int)] - exact).max())
    assert np.polyfit(np.log(STEPS), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.02)
    assert errors[-1] < 2e-4


TANK, PAPER = plants.resolve("transport_tank"), plants.resolve("activator_repressor")
REST = {"u0": "equilibrium"}
CASES = {  # plant, D(X, t), X0, settings, times; at dt = 0.005 the error of the hold, and bounds of the prediction's
    "time": (IN_TIME, InTime.D, X0, {}, (1.0, 4.0), 2.48e-3, (2e-5, 5e-6)),
    "state": (IN_SPACE, InSpace.D, X0, {}, (1.0, 4.0), 4.51e-3, (1.4e-3, 3.5e-4)),
    "tank": (TANK, lambda X, t: TANK.delay(np.array(X)), (2.8, 25.0), REST, (4.0, 7.0), 1.70e-2, (2.5e-4, 2.5e-5)),
    "constant": (PAPER, lambda X, t: 1.0, (0.03, 30.0), {"D": 1.0, "D_hat": 1.0}, (2.0, 5.0), 3.49e-3, (7e-6, 3e-7)),
}


@pytest.mark.parametrize("name", CASES)
def test_what_separates_it_from_the_loop_without_delay_is_the_hold(name):
    """From the first arrival on: the loop without delay, and that whose input is held as long as commands act.

    The hold's error is of first order in dt. The prediction's falls with its cells, as fast as cells² where only the
    staircase of the commands is in them; across the jump to the first command it is of first order where D depends on
    the state, for 1 / (1 - D_X f) is then not linear in u.
    """
    plant, D, start, settings, span, hold, bounds = CASES[name]
    U, times = plant.u_equilibrium if settings == REST else np.zeros(plant.m), np.arange(span[0], span[1] + 0.1, 0.5)
    first, X = varying_delays.arrival(lambda x, t: plant.f(x, U, t), D, start, 0.0)
    free = varying_delays.delay_free(plant.f, plant.kappa, X, first, times)
    held = varying_delays.held(plant.f, plant.kappa, D, X, first, 0.005, times)

    def gap(exact, dt, nodes):
        loop = npred.simulate(plant, RK4(plant, nodes), X0=start, t_end=span[1], dt=dt, **settings)
        return np.abs(loop.X[np.rint(times / dt).astype(int)] - exact).max()

    assert np.abs(held - free).max() == pytest.approx(hold, rel=0.01)
    assert gap(free, 0.005, 401) == pytest.approx(hold, rel=0.02)
    assert gap(free, 0.02, 401) == pytest.approx(4 * hold, rel=0.05)
    assert [gap(held, 0.005, nodes) < bound for nodes, bound in zip((101, 401), bounds, strict=True)] == [True, True]
