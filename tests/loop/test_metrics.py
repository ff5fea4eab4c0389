"""Errors and loop figures on hand-made numbers."""

from dataclasses import replace

import numpy as np
import pytest
from follower import Follower, follower
from varying_delays import with_delay

import npred
from npred import plants
from npred.loop import metrics
from npred.loop.closed_loop import Samples, Trajectories
from npred.plants import Plant
from npred.prediction.methods import RK4

PLANT = plants.resolve("activator_repressor")
EMPTY = Samples(*[np.empty(0)] * 3)


def loops(X, t):
    zeros, never = np.zeros(X.shape[:-1]), np.full(X.shape[:-2], -1)
    no = zeros > 0
    ends = never, 0.0 * never, 0.0 * never, X[..., 0, :], no, 0 * never, no, 0 * never, no, 0 * never, len(t)
    return Trajectories(t, X, zeros[..., None], zeros, zeros, zeros, never, EMPTY, X, *ends)


def test_errors_by_hand():
    P = np.full((2, 3, 2), 2.0)
    P_hat = P.copy()
    P_hat[1, 2] += [3.0, 4.0]  # the only error: |(3, 4)| = 5 at x = 1
    found = metrics.errors(PLANT, P_hat, P)
    assert found["mse"] == pytest.approx(25 / 12)
    assert found["eps_sup"] == pytest.approx(5.0)
    assert found["rel_l2"] == pytest.approx(0.5 * 5 / np.sqrt(6 * 4))
    assert found["eps_kappa"] == pytest.approx(abs(PLANT.kappa(P_hat[1, 2]) - PLANT.kappa(P[1, 2]))[0])
    assert found["mse_by_state"] == {"x1": pytest.approx(9 / 6), "x2": pytest.approx(16 / 6)}
    assert found["sup_by_state"] == {"x1": 3.0, "x2": 4.0}


@pytest.mark.filterwarnings("error")
def test_a_loop_whose_square_is_beyond_the_numbers_is_infinitely_far_without_a_warning():
    t = np.linspace(0.0, 1.0, 11)
    exploding = loops(np.logspace(0, 200, 11)[None, :, None] * np.ones(2), t)
    for far in (metrics.radius, metrics.settle_time):
        assert np.isinf(far(exploding, np.zeros(2))).all()
    assert np.isnan(metrics.decay_rate(exploding, np.zeros(2))).all()


def test_radius_looks_at_the_last_tenth_only():
    t = np.linspace(0, 10, 101)
    X = np.tile(PLANT.equilibrium, (2, 101, 1))
    X[0, 50] += 100.0
    X[0, 95] += [0.0, 0.25]
    X[1, 92] = np.nan
    radii = metrics.radius(loops(X, t), PLANT.equilibrium)
    assert radii[0] == pytest.approx(0.25) and radii[1] == np.inf
    assert metrics.converged(np.array([0.25, 0.05, np.inf]), PLANT.equilibrium).tolist() == [False, True, False]


def test_settle_time_is_the_last_entry():
    t = np.arange(5.0)
    far, near = PLANT.equilibrium * 2, PLANT.equilibrium
    X = np.stack([np.stack(p) for p in ([far, near, far, near, near], [near] * 5, [near, near, near, near, far])])
    assert metrics.settle_time(loops(X, t), PLANT.equilibrium).tolist() == [3.0, 0.0, np.inf]


def test_a_loop_to_the_origin_settles_and_converges():
    t, X = np.linspace(0, 10, 101), np.full((1, 101, 1), 1e-6)
    X[0, :20] = 0.5
    for origin in (np.zeros(1), np.full(1, -4e-19)):
        assert metrics.settle_time(loops(X, t), origin).tolist() == [pytest.approx(2.0)]
        assert metrics.converged(metrics.radius(loops(X, t), origin), origin).tolist() == [True]


def test_gain_is_the_law_from_control_error_to_radius():
    assert metrics.gain(PLANT) == pytest.approx(110.716, abs=1e-3)
    scalar = plants.resolve("scalar", {"a": 0.5, "c": 2.0})
    assert metrics.gain(scalar) == pytest.approx(0.5)  # 0 = -c X + e


def test_gain_moves_the_equilibrium_of_the_law():
    """Solve f(X, kappa(X) + e) = 0 for a small e by Newton and compare."""
    e, X = 1e-7, PLANT.equilibrium.copy()
    for _ in range(20):
        f_X, f_U = PLANT.jacobians(X, PLANT.kappa(X) + e)
        X = X - np.linalg.solve(f_X + f_U @ PLANT.kappa_jacobian(X), PLANT.f(X, PLANT.kappa(X) + e))
    assert np.linalg.norm(X - PLANT.equilibrium) / e == pytest.approx(metrics.gain(PLANT), rel=1e-3)


def test_gain_of_a_plant_that_tracks_is_that_of_its_errors():
    assert metrics.gain(follower(), 40.0) == pytest.approx(0.5, rel=1e-9)  # (X - r)' = -c (X - r) + e


def test_gain_along_a_reference_is_the_shift_of_the_loop():
    """X' = X³ + U with U = r' - r³ - X + r, whose linearisation changes in time: the loop with U + e, by RK4."""

    def kappa(x, t, p, M):
        r, slope = M.sin(t), M.cos(t)
        return [slope - r**3 - 6 * (x.X - r)]

    cubic = {"f": lambda x, u, t, p, M: [x.X**3 + u.U], "kappa": kappa, "parameters": {}, "V": lambda x, t, p, M: 0.0}
    cubic = {name: staticmethod(part) if callable(part) else part for name, part in cubic.items()}
    plant = Plant("Cubic", type("Cubic", (Follower,), cubic | {"reference": staticmethod(lambda t, p, M: [M.sin(t)])}))
    e, h, x, apart = 1e-6, 1e-3, np.zeros(1), 0.0
    for k in range(20000):
        t = k * h
        k1 = plant.f(x, plant.kappa(x, t) + e)
        k2 = plant.f(x + h / 2 * k1, plant.kappa(x + h / 2 * k1, t + h / 2) + e)
        k3 = plant.f(x + h / 2 * k2, plant.kappa(x + h / 2 * k2, t + h / 2) + e)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + plant.f(x + h * k3, plant.kappa(x + h * k3, t + h) + e))
        apart = max(apart, abs(x[0] - np.sin(t + h)) / e if t + h >= 18 else 0.0)
    assert metrics.gain(plant, 20.0) == pytest.approx(apart, rel=1e-4)
    assert apart > 1 / 5  # without the cube it is 1/6, with it at its largest all the time 1/3


def test_distances_are_of_the_reference():
    plant, t = follower(), np.linspace(0, 10, 101)
    X = np.tile(plant.target(t), (2, 1, 1))
    X[0, :20] += 1.0
    X[1, 95] += 0.2
    target = plant.target(t)
    np.testing.assert_allclose(metrics.radius(loops(X, t), target), [0.0, 0.2], atol=1e-15)
    assert metrics.settle_time(loops(X, t), target).tolist() == [pytest.approx(2.0), pytest.approx(9.6)]
    assert metrics.size(target) == pytest.approx(0.3, rel=1e-3)


def test_errors_of_kappa_are_taken_at_the_time_of_the_prediction():
    plant = Plant("Scaled", type("Scaled", (Follower,), {"kappa": staticmethod(lambda x, t, p, M: [t * x.X])}))
    P = np.zeros((2, 3, 1))
    assert metrics.errors(plant, P + 0.5, P + 0.25, np.array([1.0, 3.0]))["eps_kappa"] == pytest.approx(0.75)


@pytest.mark.parametrize("delay", [lambda x, t, p, M: x.x**2 + x.y**2, lambda x, t, p, M: (1 + t) / (1 + 2 * t)])
def test_errors_of_kappa_are_taken_at_the_time_when_the_command_acts(delay):
    """As the loop commands; t + D(X, t) is another time."""
    plant = with_delay(delay)
    loop = npred.simulate(plant, RK4(plant, 21), X0=[0.5, 0.4, 0.3], t_end=2.0, dt=0.01)
    np.testing.assert_allclose(metrics.law(plant, loop.P[:, None], loop.t, loop.D_hat), loop.U, rtol=1e-10, atol=1e-12)
    assert np.abs(plant.kappa(loop.P, loop.t + loop.D_hat) - loop.U).max() > 0.1


def test_the_error_in_the_loop_compares_what_was_predicted_with_what_came():
    """P(1, t) = X(t + D) but for one step after 2 D, and one before, which does not count."""
    t = np.arange(9.0)
    X = np.stack([t, -t], axis=-1)[None].repeat(3, axis=0)
    P = np.concatenate([X[:, 2:], X[:, -2:]], axis=1)
    P[:2, 5] += [3.0, 4.0]
    P[:, 3] += 100.0
    X[1, 8] = np.nan
    run = replace(loops(X, t), P=P)
    assert metrics.in_loop(run, 2.0).tolist() == [5.0, np.inf, 0.0]


class Settles:
    """x' = u - x, whose commands come 0.5 + 0.1 sin(x) s late."""

    states, inputs = ("x",), ("u",)
    f = lambda x, u, t, p, M: [u.u - x.x]
    kappa = lambda x, t, p, M: [0.5 * x.x + 0.25]
    delay = lambda x, t, p, M: 0.5 + 0.1 * M.sin(x.x)


def test_the_error_in_the_loop_of_a_declared_constant_is_that_of_the_constant():
    constant = Plant("constant", type("Constant", (Settles,), {"delay": staticmethod(lambda x, t, p, M: 0.5)}))
    free = Plant("free", type("Free", (Settles,), {"delay": None}))
    settings = {"X0": [[1.0], [-2.0]], "t_end": 4.0, "dt": 0.01}
    declared = metrics.in_loop_declared(npred.simulate(constant, RK4(constant, 21), **settings))
    known = metrics.in_loop(npred.simulate(free, RK4(free, 21), D=0.5, D_hat=0.5, **settings), 0.5)
    np.testing.assert_allclose(declared, known, rtol=1e-6)
    assert (known > 0).all()


def test_the_error_in_the_loop_of_a_delay_that_varies_falls_with_the_step_and_sees_a_wrong_prediction():
    plant, errors, steps = Plant("settles", Settles), [], [0.04, 0.02, 0.01]
    for dt in steps:
        loop = npred.simulate(plant, RK4(plant, 41), X0=[1.5], t_end=4.0, dt=dt)
        errors.append(metrics.in_loop_declared(loop))
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] > 0.8 and errors[-1] < 1e-3
    assert metrics.in_loop_declared(replace(loop, P=loop.P + 0.1)) == pytest.approx(0.1, abs=1e-3)


def test_a_loop_that_ends_or_is_too_short_has_an_infinite_error():
    plant = Plant("settles", Settles)
    loop = npred.simulate(plant, RK4(plant, 21), X0=[[1.5], [0.5]], t_end=3.0, dt=0.05)
    X = loop.X.copy()
    X[0, 40:] = np.nan
    assert np.isinf(metrics.in_loop_declared(replace(loop, X=X))).tolist() == [True, False]
    assert np.isinf(metrics.in_loop_declared(npred.simulate(plant, RK4(plant, 21), X0=[1.5], t_end=0.4)))


def test_the_decay_rate_is_that_of_an_exponential():
    """|X - X*| = 10^-(t + 1/2) falls by ln 10 a second; a loop that stays at a thousandth never comes to 1e-4."""
    t = np.arange(9.0)
    distance = np.stack([10 ** -(t + 0.5), np.maximum(10 ** -(t + 0.5), 1e-3)])
    for X_star in (np.zeros(1), np.full(1, 3.0)):
        unit = metrics.size(X_star)
        found = metrics.decay_rate(loops(X_star + unit * distance[..., None], t), X_star)
        assert found[0] == pytest.approx(np.log(10)) and np.isnan(found[1])


def test_the_relative_error_is_over_the_distance_of_state_and_history():
    """|P_hat - P| / (|X - X*| + sup |u - u*|) = 1, 2 and 6 over 4 + 4, the largest of them inside the horizon."""
    x, u = PLANT.equilibrium, PLANT.u_equilibrium
    history = u + np.array([0.5, -4.0, 1.0])[:, None] + np.zeros((3, 1, 1))
    P = np.zeros((3, 3, 2))
    P[:, 1, 0], P[:, 2, 1] = [1.0, -2.0, 6.0], 0.5
    found = metrics.relative(PLANT, np.tile(x + np.array([2.4, 3.2]), (3, 1)), history, P, np.zeros((3, 3, 2)))
    assert found["eps_relative"] == {"sup": pytest.approx(6 / 8), "median": pytest.approx(2 / 8)}


def test_gain_along_a_reference_counts_an_input_that_acts_otherwise_in_time():
    """X' = (2 + sin t) U with (X - r)' = -(X - r) + (2 + sin t) e: G = 2 + (sin t - cos t) / 2 beside what decays."""

    f = lambda x, u, t, p, M: [(2 + M.sin(t)) * u.U]
    kappa = lambda x, t, p, M: [(M.cos(t) - x.X + M.sin(t)) / (2 + M.sin(t))]
    parts = {"f": f, "kappa": kappa, "V": lambda x, t, p, M: 0.0, "reference": lambda t, p, M: [M.sin(t)]}
    fields = {name: staticmethod(part) for name, part in parts.items()} | {"parameters": {}}
    plant, t = Plant("Valve", type("Valve", (Follower,), fields)), np.linspace(18.0, 20.0, 401)
    exact = (2 + (np.sin(t) - np.cos(t)) / 2).max()
    assert metrics.gain(plant, 20.0) == pytest.approx(exact, rel=1e-5)
