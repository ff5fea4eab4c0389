"""Loops with a delay that varies: against a DDE over three decades of dt, and against the loop without delay."""

import numpy as np
import pytest
import varying_delays
from varying_delays import InSpace, InTime

import npred
from npred import plants
from npred.base.errors import ConfigError
from npred.prediction.methods import RK4

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
    "constant": (
        PAPER,
        lambda X, t: 1.0,
        (0.03, 30.0),
        {"D": 1.0, "D_hat": 1.0, "u0": [0.0]},
        (2.0, 5.0),
        3.49e-3,
        (7e-6, 3e-7),
    ),
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


class Swing:
    """A pendulum whose law knows the time; its torque is 0.3 s late."""

    states, inputs, box = ("angle", "speed"), ("torque",), {"angle": (-1.0, 1.0), "speed": (-1.0, 1.0)}
    f = lambda x, u, t, p, M: [x.speed, 4 * M.sin(x.angle) + u.torque]
    kappa = lambda x, t, p, M: [-4 * M.sin(x.angle) - 2 * x.angle - 2 * x.speed + 0.1 * M.cos(t)]


class LateSwing(Swing):
    delay = lambda x, t, p, M: 0.3


SENSORS = npred.Measurement(relative_noise=0.01, noise=0.01, period=0.05, delay=0.03, drop=0.2, seed=5)


@pytest.mark.parametrize("measurement", [None, SENSORS])
@pytest.mark.parametrize("actuator", ["measured", "history"])
@pytest.mark.parametrize("closed", [False, True])
def test_without_prediction_a_declared_delay_is_that_number(closed, actuator, measurement):
    """The open loop, and that of D_hat = 0: to the bit the loops of the plant whose delay simulate is told."""
    runs, more = [], {"u0": 0.5, "t_end": 3.0, "dt": 0.01}
    more |= {"actuator": actuator, "measurement": measurement} if closed else {}
    for kind, delays in (
        (LateSwing, {"D_hat": 0.0} if closed else {}),
        (Swing, {"D": 0.3, "D_hat": 0.0 if closed else 0.3}),
    ):
        plant = plants.Plant("swing", kind)
        predictor = RK4(plant, 21) if closed else None
        runs.append(npred.simulate(plant, predictor, X0=[[0.3, 0.0], [-0.2, 0.4]], **more, **delays))
    declared, told = runs
    assert np.isfinite(declared.X).all() and (declared.infeasible == -1).all()
    np.testing.assert_array_equal(declared.X, told.X)
    np.testing.assert_array_equal(declared.U, told.U)
    np.testing.assert_allclose(declared.energy, told.energy, rtol=1e-12)  # on a clock summed in another order
    assert closed == bool(np.any(declared.U))
    assert not closed or not declared.D_hat.any()


@pytest.mark.parametrize("name", [row["name"] for row in plants.named()])
def test_the_open_loop_of_every_plant_that_declares_its_delay_is_finite(name):
    plant = plants.resolve(name)
    if not plant.declares_delay:
        return
    X0 = 1.05 * plant.target(0.0) if plant.rests else plant.guess
    for predictor, more in ((None, {}), (RK4(plant, 21), {"D_hat": 0}), (RK4(plant, 21), {})):
        loop = npred.simulate(plant, predictor, X0=X0, t_end=1.0, u0="equilibrium", **more)
        assert np.isfinite(loop.X).all() and loop.infeasible == -1


def test_the_open_loop_switches_when_the_last_command_before_it_arrives():
    """Of the tank, from u0 to 0, at a time that its state decides: against SciPy."""
    start, U = (2.8, 25.0), TANK.u_equilibrium
    first, X = varying_delays.arrival(lambda x, t: TANK.f(x, U, t), lambda x, t: TANK.delay(x, t), start, 0.0)
    times = np.arange(np.ceil(first), first + 3.0)
    rest = varying_delays.delay_free(TANK.f, lambda x, t: np.zeros(TANK.m), X, first, times)
    loop = npred.simulate(TANK, None, X0=start, t_end=times[-1], dt=0.005, u0="equilibrium")
    assert np.abs(loop.X[np.rint(times / 0.005).astype(int)] - rest).max() < 1e-6


@pytest.mark.parametrize("D_hat", [0.3, [0.0, 0.1]])
def test_another_estimate_of_a_declared_delay_is_refused(D_hat):
    with pytest.raises(ConfigError, match=r"D_hat: expected a plant that .*; give 0 for no prediction, or no D_hat"):
        npred.simulate(TANK, RK4(TANK, 21), X0=(2.8, 25.0), t_end=1.0, D_hat=D_hat)
