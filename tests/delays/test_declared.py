"""A delay that the plant declares: predictions against SciPy and closed forms, loops against the delay-free one."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import npred
from npred import plants
from npred.errors import ConfigError
from npred.plants import Plant
from npred.predictors import RK4, Euler, Heun


class Unicycle:
    """Pomet's law for the unicycle, its commands late by the squared distance from the origin."""

    states, inputs, period = ("x", "y", "theta"), ("omega", "v"), 2 * np.pi / 3

    def f(x, u, t, p, M):
        return [u.v * M.cos(x.theta), u.v * M.sin(x.theta), u.omega]

    def kappa(x, t, p, M):
        along = x.x * M.cos(x.theta) + x.y * M.sin(x.theta)
        across = x.x * M.sin(x.theta) - x.y * M.cos(x.theta)
        omega = -5 * along**2 * M.cos(3 * t) - along * across * (1 + 25 * M.cos(3 * t) ** 2) - x.theta
        return [omega, -along + 5 * across * (M.sin(3 * t) - M.cos(3 * t)) + across * omega]

    def reference(t, p, M):
        return [0.0 * t, 0.0 * t, 0.0 * t]

    def delay(x, t, p, M):
        return x.x**2 + x.y**2


class InTime(Unicycle):
    """The same with D(t) = (1 + t) / (1 + 2 t), which falls from 1 s to 0.5 s."""

    def delay(x, t, p, M):
        return (1 + t) / (1 + 2 * t)


class Decay:
    """X' = -X with D = 0.6 + 0.3 tanh X: P = X exp(-D(P))."""

    states, inputs = ("x",), ("u",)

    def f(x, u, t, p, M):
        return [-x.x + u.u]

    def kappa(x, t, p, M):
        return [0.0 * x.x]

    def V(x, t, p, M):
        return x.x**2

    def delay(x, t, p, M):
        return 0.6 + 0.3 * M.tanh(x.x)


UNICYCLE, IN_TIME, DECAY = Plant("unicycle_d", Unicycle), Plant("in_time", InTime), Plant("decay", Decay)


def commands(x):
    return np.stack([np.sin(2 * x + 0.3), 0.3 * np.cos(3 * x)], axis=-1)


def predicted(X, t, delay, gradient, by_time):
    """P(1) and s(1) by SciPy: dP/dx = H g f, ds/dx = H g."""

    def slope(x, z):
        u, (P, s) = commands(x), (z[:3], z[3])
        f = np.array([u[1] * np.cos(P[2]), u[1] * np.sin(P[2]), u[0]])
        return H / (1 - gradient(P) @ f - by_time(s)) * np.array([*f, 1.0])

    H = delay(X, t)
    return solve_ivp(slope, (0, 1), [*X, t], rtol=1e-12, atol=1e-14).y[:, -1]


CASES = {
    "state": (UNICYCLE, lambda X, t: X[0] ** 2 + X[1] ** 2, lambda P: np.array([2 * P[0], 2 * P[1], 0]), lambda s: 0.0),
    "time": (IN_TIME, lambda X, t: (1 + t) / (1 + 2 * t), lambda P: np.zeros(3), lambda s: -1 / (1 + 2 * s) ** 2),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("method", "order"), [(Euler, 1), (Heun, 2), (RK4, 4)])
def test_each_method_keeps_its_order(case, method, order):
    plant, delay, gradient, by_time = CASES[case]
    X, t = np.array([0.5, 0.4, 0.3]), 0.7
    *P, s = predicted(X, t, delay, gradient, by_time)
    assert s == pytest.approx(t + delay(P, s), abs=1e-10)  # s(1) is when the command acts
    nodes = np.array([21, 41, 81, 161]) if order == 4 else np.array([41, 81, 161, 321])
    runs = [method(plant, nx)(X, commands(np.linspace(0, 1, nx)), delay(X, t), t)[-1] for nx in nodes]
    errors = np.abs(np.array(runs) - P).max(axis=1)
    assert -np.polyfit(np.log(nodes - 1), np.log(errors), 1)[0] == pytest.approx(order, abs=0.15)


def test_the_closed_form_of_the_scalar_diagnostic():
    """P = X exp(-D(P)) without an input [Zhao, Gao, Xu, Kao, Automatica 144 (2022) 110479, corrected]."""
    for X, P in ((0.2, 0.10632902870502527), (0.1, 0.05400009924092605), (0.05, 0.027217489803397023)):
        H = 0.6 + 0.3 * np.tanh(X)
        assert RK4(DECAY, 401)([X], np.zeros((401, 1)), H)[-1, 0] == pytest.approx(P, abs=1e-12)


def test_a_constant_through_the_general_formula_is_a_constant_to_the_bit():
    built_in = plants.resolve("activator_repressor")
    general = Plant(
        "general", type("General", (built_in.declaration,), {"delay": staticmethod(lambda x, t, p, M: 1.0)})
    )
    start = {"X0": [[0.03, 30.0], [0.1, 6.0]], "t_end": 5.0}
    loops = npred.simulate(general, npred.predictor("rk4", general), **start)
    constant = npred.simulate(built_in, npred.predictor("rk4", built_in), D=1.0, D_hat=1.0, **start)
    assert np.array_equal(loops.X, constant.X) and np.array_equal(loops.P, constant.P)


def delay_free(X0, t0, times):
    """The loop of kappa without a delay from X0 at t0, by SciPy."""

    def slope(t, X):
        return UNICYCLE.f(X, UNICYCLE.kappa(X, t), t)

    return solve_ivp(slope, (t0, times[-1]), X0, t_eval=times, rtol=1e-11, atol=1e-13).y.T


@pytest.mark.parametrize(
    ("plant", "X0", "arrives"), [(UNICYCLE, (0.5, 0.5, 0.5), 0.5), (IN_TIME, (0.3, 0.2, 0.1), 0.7071)]
)
def test_from_the_first_command_on_the_loop_is_the_delay_free_one(plant, X0, arrives):
    """It rests until its first command arrives; from there on the error falls with dt."""
    if plant is IN_TIME:  # sigma(0) = D(sigma(0)): 2 s² = 1
        arrives = np.sqrt(0.5)
    times, errors = np.arange(1.0, 8.01, 0.5), []
    steps = [0.02, 0.01, 0.005, 0.0025]
    for dt in steps:
        loop = npred.simulate(plant, RK4(plant, 101), X0=X0, t_end=8.0, dt=dt)
        X = loop.X[np.rint(times / dt).astype(int)]
        errors.append(np.abs(X - delay_free(X0, arrives, times)).max())
        resting = loop.t < arrives - dt
        assert np.array_equal(loop.X[resting], np.broadcast_to(X0, (resting.sum(), 3)))
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.25)
    assert errors[2] < 6e-3


def test_the_first_command_from_the_published_start():
    loop = npred.simulate(UNICYCLE, RK4(UNICYCLE, 201), X0=[1.0, 1.0, 1.0], t_end=0.01)
    np.testing.assert_allclose(loop.U[0, ::-1], [-9.32412, -20.173825], rtol=1e-6)
    assert loop.D_hat[0] == 2.0


def test_commands_that_would_overtake_each_other_mark_the_loop_and_end_it():
    loops = npred.simulate(UNICYCLE, RK4(UNICYCLE, 101), X0=[[1.0, 1.0, 1.0], [0.3, 0.3, 0.3]], t_end=6.0)
    k = loops.infeasible[0]
    assert 300 < k < 700 and loops.infeasible[1] == -1
    assert loops.margin[0] <= 0 and np.isnan(loops.margin[1])
    assert np.isfinite(loops.X[0, k]).all() and np.isnan(loops.X[0, k + 1 :]).all()
    assert np.isfinite(loops.X[1]).all()
    assert f"first at control step {k}, x = " in str(loops) and "expected above 0" in str(loops)


@pytest.mark.parametrize("given", [{"D": 1.0}, {"D_hat": 1.0}, {"adaptation": npred.DelayObserver()}])
def test_a_declared_delay_takes_no_other(given):
    with pytest.raises(ConfigError, match=r"expected none, for plant unicycle_d declares its delay; leave \w+ out"):
        npred.simulate(UNICYCLE, RK4(UNICYCLE), X0=[0.5, 0.5, 0.5], t_end=1.0, **given)


def test_what_the_family_lacks_is_refused_with_the_cure():
    with pytest.raises(ConfigError, match=r"picard: expected a delay that is a number, .*; use rk4"):
        npred.predictor("picard", DECAY)


def test_the_delay_is_part_of_the_identity():
    program = UNICYCLE.identity["program"]
    assert set(program) - set(plants.resolve("scalar").identity["program"]) == {"delay", "reference"}
    assert isinstance(program, dict) and program["delay"] != IN_TIME.identity["program"]["delay"]
    assert IN_TIME.clocked and not UNICYCLE.clocked
