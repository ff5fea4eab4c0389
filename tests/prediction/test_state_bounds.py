"""Plants whose states stop at bounds: every family of kernels against the formula of a stop, and what refuses them."""

import numpy as np
import pytest

import npred
from npred.base.errors import ConfigError
from npred.formulas import array_math
from npred.lab.scheduler.configuration import identity
from npred.plants import BlackBox, Plant
from npred.prediction.delays import problem_of
from npred.prediction.delays.family import BOUNDED
from npred.prediction.methods import RK4

HIGH, D, NX = 0.5, 1.0, 201


class Slide:
    """The integral of what arrives, which stops at 0.5; y follows behind, free."""

    states, inputs, state_bounds = ("x", "y"), ("u", "v"), {"x": (-np.inf, HIGH)}
    box = {"x": (-0.2, 0.2), "y": (-0.2, 0.2)}
    f = lambda x, u, t, p, M: [u.u, u.v - x.y]
    kappa = lambda x, t, p, M: [-x.x, -x.y]
    V = lambda x, t, p, M: x.x**2 + x.y**2


class SlideTwoDelays(Slide):
    delays = (D, 0.5)


class SlideDeclared(Slide):
    delay = lambda x, t, p, M: D + 0.0 * x.x


class SlideCalled(Slide):
    traced = False
    f = lambda X, u, t, p: np.stack([u[:, 0], u[:, 1] - X[:, 1]], axis=-1)
    kappa = lambda X, t, p: -X
    V = lambda X, t, p: (X**2).sum(axis=-1)


PLANTS = [Plant(kind.__name__, kind) for kind in (Slide, SlideTwoDelays, SlideDeclared)] + [
    BlackBox("Called", SlideCalled)
]


def stopped(free):
    """A path that stops at HIGH: the free one less the most that it was above so far (Skorokhod)."""
    return free - np.maximum.accumulate(np.maximum(free - HIGH, 0.0), axis=-1)


@pytest.mark.parametrize("lanes", [1, 6])
@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_predictions_stop_at_the_bound_and_leave_it(plant, lanes):
    x, starts = np.linspace(0, 1, NX), np.linspace(-0.1, 0.3, lanes)
    u = np.stack([2.0 * np.sin(5.5 * x), 0.0 * x], axis=-1)
    P = RK4(plant, NX)(np.stack([starts, 0 * starts], axis=-1), np.broadcast_to(u, (lanes, NX, 2)), D)[..., 0]
    free = starts[:, None] + 2.0 / 5.5 * (1 - np.cos(5.5 * x))
    assert (free.max(axis=-1) > HIGH).all() and free[0, -1] < HIGH
    np.testing.assert_allclose(P, stopped(free), atol=1e-4)
    assert P.max() <= HIGH


@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_the_simulated_plant_stops_too_and_is_where_it_was_predicted(plant):
    named = {} if plant.declares_delay else {"D": D, "D_hat": D}
    loop = npred.simulate(plant, RK4(plant, 51), X0=[0.2, 0.0], t_end=4.0, dt=0.02, u0=[1.0, 0.0], **named)
    x, ahead = loop.X[:, 0], round(D / 0.02)
    np.testing.assert_allclose(x[:ahead], np.minimum(0.2 + loop.t[:ahead], HIGH), atol=1e-12)
    assert x.max() == HIGH
    np.testing.assert_allclose(loop.P[:-ahead, 0], x[ahead:], atol=0.02)
    assert abs(x[-1]) < 0.1


def test_what_is_not_finite_stays_visible():
    values = PLANTS[0].stopped([np.array([np.nan, 2.0, -np.inf]), np.zeros(3)], array_math.NUMPY)[0]
    np.testing.assert_array_equal(values, [np.nan, HIGH, -np.inf])


@pytest.mark.parametrize("part", BOUNDED)
def test_what_reads_f_at_the_bound_is_refused_with_what_to_do(part):
    with pytest.raises(ConfigError, match="expected a plant without state_bounds, plant Slide has some; "):
        problem_of(PLANTS[0]).needs(part)


def test_a_start_outside_is_refused():
    with pytest.raises(ConfigError, match=r"X0: expected x within its state_bounds \[-inf, 0.5\], got 0.6 to 0.6"):
        npred.simulate(PLANTS[0], None, D=D, D_hat=D, X0=[0.6, 0.0], t_end=1.0)


def test_the_bounds_are_part_of_the_identity():
    free = Plant("Slide", type("Free", (Slide,), {"state_bounds": {}}))
    assert identity(free)["state_bounds"] == {}
    assert identity(PLANTS[0])["state_bounds"] == {"x": ["-inf", HIGH]}


def test_a_delay_observer_is_refused():
    with pytest.raises(ConfigError, match="freeze the estimate"):
        law = npred.DelayObserver(bounds=(0.1, 2.0))
        npred.simulate(PLANTS[0], RK4(PLANTS[0], 21), D=D, D_hat=D, X0=[0.0, 0.0], t_end=1.0, adaptation=law)
