"""The update law: golden numbers, identities of q1 and w, the projection; and the published law without measured u."""

import numpy as np
import pytest
from golden import CASES, case
from hypothesis import given, settings
from hypothesis import strategies as st
from input_histories import means
from scipy.integrate import solve_ivp

import npred
from npred import plants
from npred.base import grid
from npred.base.errors import ConfigError
from npred.estimation.adaptation import DelayAdaptation
from npred.estimation.delay_law import DelayLaw
from npred.formulas import called_functions
from npred.loop.closed_loop import simulate
from npred.plants import Plant
from npred.plants.black_box import BlackBox
from npred.prediction import methods as predictors
from npred.prediction.delays.problem import transition
from npred.prediction.methods import RK4

PLANT = plants.resolve("activator_repressor")
SCALAR = plants.resolve("scalar", {"a": 0.8, "c": 1.0})
LAW = DelayAdaptation(gamma=1000.0, b=1.0)


@pytest.mark.parametrize("name", CASES)
def test_golden_phi_on_a_fine_grid(name):
    golden = case(name)
    u = golden.u(grid.nodes(4001))[:, None]
    P = RK4(PLANT)(golden.X, u, golden.D_hat)
    phi = LAW.phi(PLANT, golden.X, u, P, golden.D_hat)
    np.testing.assert_allclose(phi, golden.phi, rtol=1e-6, atol=1e-8 * abs(golden.phi))
    assert abs(phi - golden.phi) < 1e-8


@pytest.mark.parametrize("name", CASES)
def test_golden_q1_by_the_transition_formula(name):
    """The formula that is traced into the kernel, here on numbers: q1 = kappa'(P) r with r(0) = f(X, u(0))."""
    golden, nx = case(name), 4001
    u, h = golden.u(grid.nodes(nx))[:, None], golden.D_hat / (nx - 1)
    P = RK4(PLANT)(golden.X, u, golden.D_hat)
    df = lambda x, inputs, t, v: PLANT.jacobians(x, inputs)[0] @ v
    r = PLANT.f(P[0], u[0])
    s, q1 = h * df(P[0], u[0], 0.0, r), []
    for j in range(1, nx):
        r, s = transition(df, P[j], u[j], 0.0, h, r, s)
        if j % 1000 == 0:
            q1.append(PLANT.kappa_jacobian(P[j]) @ r)
    np.testing.assert_allclose(np.ravel(q1), np.ravel(golden.q1), rtol=1e-5, atol=1e-9)
    w = u[1000::1000] - PLANT.kappa(P[1000::1000])
    np.testing.assert_allclose(np.ravel(w), np.ravel(golden.w), atol=1e-9)


@given(X=st.floats(-2, 2), U=st.floats(-1, 1), D_hat=st.floats(0.1, 2))
@settings(max_examples=25)
def test_scalar_phi_in_closed_form(X, U, D_hat):
    """u constant: P = e^{g x} X + (e^{g x} - 1) U / a, r = (a X + U) e^{g x}, kappa = -(a + c) X, V = X²."""
    a, c, x = 0.8, 1.0, grid.nodes(2001)
    u, growth = np.full((2001, 1), U), np.exp(a * D_hat * x)
    P = growth * X + (growth - 1) * U / a
    w, q1 = U + (a + c) * P, -(a + c) * (a * X + U) * growth
    I1, I2 = (np.trapezoid((1 + x) * y, x) for y in (q1 * w, w**2))
    phi = LAW.phi(SCALAR, [X], u, P[:, None], D_hat)
    np.testing.assert_allclose(phi, -I1 / (1 + X**2 + I2), rtol=1e-5, atol=1e-12)


@given(X=st.floats(-2, 2), D_hat=st.floats(0.1, 2))
@settings(max_examples=25)
def test_no_backstepping_error_no_update(X, D_hat):
    """u(x) = kappa(P(x)) has w = 0, so phi = 0: along X' = -c X the input is known in closed form."""
    P = np.exp(-D_hat * grid.nodes(101))[:, None] * X
    assert abs(LAW.phi(SCALAR, [X], -1.8 * P, P, D_hat)) < 1e-12


def test_constant_input_moves_along_f():
    """u constant in x: f(P(x), u) = Phi(x, 0) f(X, u), so q1 = kappa'(P) f(P, u)."""
    nx, h = 2001, 1.2 / 2000
    u = np.full((nx, 1), 0.03)
    P = predictors.numerical("rk4", PLANT, nx)([0.08, 6.0], u, 1.2)
    df = lambda x, inputs, t, v: PLANT.jacobians(x, inputs)[0] @ v
    r = PLANT.f(P[0], u[0])
    s = h * df(P[0], u[0], 0.0, r)
    for j in range(1, nx):
        r, s = transition(df, P[j], u[j], 0.0, h, r, s)
    np.testing.assert_allclose(r, PLANT.f(P[-1], u[-1]), rtol=1e-6)


def test_batch_equals_single_calls():
    random = np.random.default_rng(2)
    X, u, D_hat = random.uniform(0.1, 2, (5, 2)), random.uniform(0, 0.2, (5, 41, 1)), random.uniform(0.2, 1.5, 5)
    P = RK4(PLANT, 41)(X, u, D_hat)
    phi = LAW.phi(PLANT, X, u, P, D_hat)
    assert phi.shape == (5,)
    for k in range(5):
        np.testing.assert_allclose(phi[k], LAW.phi(PLANT, X[k], u[k], P[k], D_hat[k]), rtol=1e-12)


def adapted(D_hat, phi, low, high):
    """The estimate after a control step of a second with this rate."""

    class Steady(DelayLaw):
        def rate(self, plant, X, u, P, D_hat, t):
            return np.full_like(D_hat, phi)

    steps = {"D": 2.0, "D_hat": D_hat, "X0": [0.1] * PLANT.n, "t_end": 1.0, "dt": 1.0}
    return simulate(PLANT, RK4(PLANT, 5), adaptation=Steady(bounds=(low, high)), **steps).D_hat[1]


@given(D_hat=st.floats(0.1, 4.0), phi=st.floats(-5, 5), low=st.just(0.1), high=st.just(4.0))
def test_projection_keeps_the_estimate_inside(D_hat, phi, low, high):
    assert low <= (after := adapted(D_hat, phi, low, high)) <= high
    if low < D_hat + phi < high:
        assert after == D_hat + phi


@pytest.mark.parametrize(
    "bad",
    [
        {"gamma": -1.0},
        {"b": 0.0},
        {"bounds": (2.0, 1.0)},
        {"bounds": (-1.0, 1.0)},
        {"gamma": float("nan")},
        {"gamma": "high"},
        {"gamma": float("inf")},
        {"bounds": (1.0,)},
        {"bounds": 1.0},
        {"bounds": (0.1, 1.0, 2.0)},
    ],
)
def test_senseless_settings_are_told(bad):
    with pytest.raises(ConfigError, match=r"adaptation: .*expected"):
        DelayAdaptation(**bad)


@pytest.mark.parametrize(
    ("X", "u", "P", "message"),
    [
        ((1,), (5, 1), (5, 2), r"X: expected shape \(..., 2\)"),
        ((2,), (5,), (5, 2), r"u: expected shape \(..., nx, 1\)"),
        ((2,), (5, 2), (5, 2), r"u: expected shape \(..., nx, 1\)"),
        ((2,), (5, 1), (9, 2), r"P: expected shape \(..., nx, 2\), nx >= 2 the same in u and P, got \(9, 2\)"),
        ((2,), (1, 1), (1, 2), "nx >= 2"),
        ((3, 2), (4, 5, 1), (5, 2), r"leading axes X \(3,\), u \(4,\)"),
    ],
)
def test_phi_of_shapes_that_do_not_fit_is_told(X, u, P, message):
    with pytest.raises(ConfigError, match=message):
        DelayAdaptation().phi(PLANT, np.ones(X), np.ones(u), np.ones(P), 1.0)


class Follower:
    """x' = -x/2 + U + sin(t)/4, led along sin t: f and kappa both depend on time."""

    states, inputs, guess = ("x",), ("U",), (0.0,)
    f = lambda x, u, t, p, M: [-x.x / 2 + u.U + M.sin(t) / 4]
    kappa = lambda x, t, p, M: [x.x / 2 + M.cos(t) - M.sin(t) / 4 - (1 + M.cos(t) ** 2) * (x.x - M.sin(t))]
    V = lambda x, t, p, M: (x.x - M.sin(t)) ** 2
    reference = lambda t, p, M: [M.sin(t)]


class ClockInside:
    """The same plant with sin t and cos t as states of its own."""

    states, inputs, guess = ("x", "s", "c"), ("U",), (0.0, 0.0, 0.0)
    f = lambda x, u, t, p, M: [-x.x / 2 + u.U + x.s / 4, x.c, -x.s]
    kappa = lambda x, t, p, M: [x.x / 2 + x.c - x.s / 4 - (1 + x.c**2) * (x.x - x.s)]
    V = lambda x, t, p, M: (x.x - x.s) ** 2


class FollowerOnArrays:
    """The follower as a plant that is not traced."""

    states, inputs, traced = ("x",), ("U",), False
    f = lambda X, u, t, p: -X / 2 + u + (np.sin(t) / 4 * np.ones(len(X)))[:, None]

    def kappa(X, t, p):
        s, c = (wave(t) * np.ones(len(X)) for wave in (np.sin, np.cos))
        return (X[:, 0] / 2 + c - s / 4 - (1 + c**2) * (X[:, 0] - s))[:, None]

    V = lambda X, t, p: (X[:, 0] - np.sin(t)) ** 2
    reference = lambda t, p: np.sin(t)[:, None]


def follower(kind):
    return BlackBox("follower", FollowerOnArrays) if kind == "black box" else Plant("follower", Follower)


@pytest.mark.parametrize("kind", ["traced", "called", "black box"])
def test_phi_of_a_law_of_time_is_that_of_the_clock_as_states(kind, monkeypatch):
    """q1 = kappa_P r + kappa_s, r_x = D_hat (f_P r + f_s): the clock's share of the derivative along the prediction."""
    if kind == "called":
        monkeypatch.setattr(called_functions, "LONG", 0)
    plant, inside, t, D_hat = follower(kind), Plant("clock", ClockInside), 0.7, 1.3
    u = np.cos(3 * grid.nodes(801))[:, None]
    state = [0.4, np.sin(t), np.cos(t)]
    phi = LAW.phi(plant, [0.4], u, RK4(plant, 801)([0.4], u, D_hat, t), D_hat, t)
    wanted = LAW.phi(inside, state, u, RK4(inside, 801)(state, u, D_hat), D_hat)
    assert abs(wanted) > 0.1
    np.testing.assert_allclose(phi, wanted, rtol=1e-5)


def test_q1_of_a_law_of_time_moves_w_along_its_transport():
    """D w_t - w_x = -(D - D_hat) q1 at frozen D_hat, by differences of w alone: no derivative of f or kappa."""
    plant, D, D_hat, t, step, nx = follower("traced"), 1.0, 1.3, 0.7, 1e-4, 2001
    nodes = grid.nodes(nx)

    def w(moment):
        u = np.cos(3 * (moment + D * (nodes - 1)))[:, None]  # U(s) = cos 3s, read at t + D (x - 1)
        X = solve_ivp(lambda s, x: plant.f(x, np.cos([3 * (s - D)]), s), (t, moment), [0.4], rtol=1e-12, atol=1e-12).y[
            :, -1
        ]
        mean = means(lambda x: np.cos(3 * (moment + D * (x - 1)))[..., None], nx)
        P = RK4(plant, nx)(X, mean, D_hat, moment)
        kappa = plant.kappa(P, moment + nodes * D_hat)
        return (u - kappa)[:, 0], u, P, X

    (before, *_), (now, u, P, X), (after, *_) = w(t - step), w(t), w(t + step)
    q1 = -(D * (after - before) / (2 * step) - np.gradient(now, nodes, edge_order=2)) / (D - D_hat)
    I1, I2 = (np.trapezoid((1 + nodes) * y, nodes) for y in (q1 * now, now**2))
    wanted = -I1 / (1 + plant.V(X, t) + I2)
    np.testing.assert_allclose(LAW.phi(plant, X, u, P, D_hat, t), wanted, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.8, 1.2])
def test_a_tracking_loop_finds_its_delay(start):
    plant = follower("traced")
    law = DelayAdaptation(gamma=0.2, bounds=(0.1, 3.0))
    loop = simulate(
        plant, RK4(plant, 101), D=1.0, D_hat=start, X0=[0.5], t_end=200.0, dt=0.01, adaptation=law, every=100
    )
    assert abs(loop.D_hat[-1] - 1.0) <= 0.05
    assert abs(loop.X[-1] - plant.target(200.0)) < 1e-2


def test_a_plant_without_V_is_refused_and_told_of_the_laws_that_take_none():
    """It was simulated with V = 0."""
    bare = Plant("bare", type("Bare", (npred.plant("scalar").declaration,), {"V": None}))
    words = r"plant bare: expected V\(x, t, p, M\), .* found none; .* DelayObserver or L1Adaptation"
    settings = {"D": 1.0, "D_hat": 1.2, "X0": [1.0], "t_end": 0.1, "dt": 0.05}
    with pytest.raises(ConfigError, match=words):
        npred.simulate(bare, npred.predictor(bare, "heun", 11), adaptation=DelayAdaptation(gamma=1.0), **settings)
    npred.simulate(bare, npred.predictor(bare, "heun", 11), adaptation=npred.L1Adaptation(), **settings)


CHEMOSTAT = npred.plant("chemostat")


def formula(plant, u, P, D_hat, t, epsilon):
    """phi of one loop, kappa's derivative by differences; u (nx, m), P (nx, n)."""
    nx, h = len(u), 1e-6
    x, times = np.linspace(0, 1, nx), t + np.linspace(0, 1, nx) * D_hat
    velocity = plant.f(P[0], u[0], t)
    w = u - plant.kappa(P, times)
    q = (plant.kappa(P + h * velocity, times) - plant.kappa(P - h * velocity, times)) / (2 * h)
    w_x, q_x = np.gradient(w, x, axis=0), np.gradient(q, x, axis=0)
    sign = lambda values: values / (np.abs(values) + epsilon)
    integrand = (1 + x[:, None]) * (q * sign(w) + q_x * sign(w_x))
    return (2 * sign(w_x[-1]) * q[-1]).sum() + np.trapezoid(integrand, x, axis=0).sum()


@pytest.mark.parametrize("name", ["chemostat", "activator_repressor", "planar_arm2"])
def test_phi_is_the_formulas(name):
    plant, rng = npred.plant(name), np.random.default_rng(0)
    rest = plant.target(0.0)
    P = rest + 0.1 * rng.normal(size=(3, 21, plant.n))
    u, D_hat = plant.u_target(0.0) + rng.normal(size=(3, 21, plant.m)), np.array([0.4, 1.0, 1.7])
    law = npred.L1Adaptation(gamma=2.0, epsilon=0.01)
    expected = [2 * formula(plant, u[i], P[i], D_hat[i], 0.3, 0.01) for i in range(3)]
    np.testing.assert_allclose(law.rate(plant, P[:, 0], u, P, D_hat, 0.3), expected, rtol=1e-5)


def chemostat(D, D_hat):
    return npred.simulate(
        CHEMOSTAT, npred.predictor(CHEMOSTAT, "rk4", nx=101), D=D, D_hat=D_hat, X0=[2.0, 2.0], t_end=60.0, u0="law",
        adaptation=npred.L1Adaptation(gamma=1.0, bounds=(0.8, 2.0)), actuator="history",
    )  # fmt: skip


def test_it_brings_the_chemostat_to_rest_from_near_the_delay():
    run = chemostat([1.6, 1.4], 1.8)
    assert np.abs(run.X[:, -200:] - CHEMOSTAT.equilibrium).max() < 2e-6  # 1.2e-6, still falling
    assert abs(run.D_hat[0, -1] - 1.6) < 0.1  # 1.5959 in the published discretisation, corrected


def test_plants_without_one_delay_to_estimate_are_refused():
    with pytest.raises(ConfigError, match="expected one delay, plant unicycle has delays"):
        npred.L1Adaptation().check(npred.plant("unicycle"))
