"""Inputs with delays of their own: each predictor against DOP853 in pieces, its order, and the limits it must meet."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import npred
from npred import plants
from npred.base import grid
from npred.base.errors import ConfigError
from npred.base.registry import METHODS
from npred.estimation.adaptation import DelayAdaptation
from npred.lab.scheduler.configuration import identity
from npred.loop.closed_loop import simulate
from npred.plants import Plant
from npred.prediction import methods as predictors
from npred.prediction.delays.constant import ConstantDelay
from npred.prediction.methods import RK4, Euler, Picard

D_HAT = 0.7
ONESTEP = [name for name in METHODS.builtin if name not in ("picard", "semi_implicit", "rollout")]


def plant(delays=None, inputs=2):
    """A pendulum-like chain driven by one input a state, with a law that sees the time."""

    class Chain:
        states, box = ("a", "b", "c"), dict.fromkeys("abc", (-1.0, 1.0))

        def f(x, u, t, p, M):
            drives = [*u, 0.0, 0.0]
            return [x.b + drives[0], M.sin(x.c) + drives[1], drives[2] - x.a]

        def kappa(x, t, p, M):
            return [-2 * x.a - x.b + 0.3 * M.sin(2 * t), -x.b - x.c - x.a * x.b, -x.c * x.c + M.cos(t)][:inputs]

        V = lambda x, t, p, M: x.a**2 + x.b**2 + x.c**2

    Chain.inputs = ("u1", "u2", "u3")[:inputs]
    if delays:
        Chain.delays = delays
    return Plant("chain", Chain)


class Integrators:
    """Each state is the integral of what arrives of an input that does not hang on it."""

    states, inputs, delays = ("a", "b"), ("u", "v"), (0.37, 1.0)
    f = lambda x, u, t, p, M: [u.u, u.v]
    kappa = lambda x, t, p, M: [M.sin(3 * t), M.cos(2 * t)]
    V = lambda x, t, p, M: 0.0 * x.a


INTEGRATORS = Plant("integrators", Integrators)


def u(x, inputs=2):
    return np.stack([np.sin(3 * x + 1), 0.5 + x * x, np.cos(5 * x)][:inputs], axis=-1)


def exact(plant, X, u, t, ends):
    """P at x = `ends` by DOP853, restarted where an input changes from its history u(x) to the law."""

    def rate(x, P):
        law = plant.kappa(P, t + x * D_HAT)
        v = [u(x / r)[c] if middle < r else law[c] for c, r in enumerate(plant.ratios)]
        return D_HAT * plant.f(P, np.array(v), t + x * D_HAT)

    P, begin, found = np.array(X, dtype=float), 0.0, {0.0: np.array(X, dtype=float)}
    for end in sorted({*plant.ratios, *ends} - {0.0}):
        middle = (begin + end) / 2
        P = solve_ivp(rate, (begin, end), P, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        begin, found[end] = end, P
    return np.array([found[x] for x in ends])


@pytest.mark.parametrize("method", ONESTEP)
@pytest.mark.parametrize("delays", [(0.25, 0.6), (0.6, 0.25), (0.31, 0.32, 0.6), (0.0, 0.6), (0.6, 0.31, 0.0)])
def test_fitted_order_against_dop853_with_kinks_between_nodes(method, delays):
    declared, X, t = plant(delays, len(delays)), [0.5, -0.3, 0.8], 0.4
    intervals, quarters = [40, 80, 160], [0.25, 0.5, 0.75, 1.0]
    P = exact(declared, X, lambda x: u(x, len(delays)), t, quarters)
    errors = []
    for n in intervals:
        found = predictors.numerical(method, declared, n + 1)(X, u(grid.nodes(n + 1), len(delays)), D_HAT, t)
        errors.append(np.abs(found[[n // 4, n // 2, 3 * n // 4, n]] - P).max())
    order = -np.polyfit(np.log(intervals), np.log(errors), 1)[0]
    assert order == pytest.approx(min(predictors.method(method).order, 2), abs=0.25)  # u is read to order 2
    assert errors[-1] < {"euler": 1e-2}.get(method, 1e-4)


def test_an_input_past_its_history_is_the_law_and_not_zero():
    """Held at 0 there, P would be off by a tenth and more."""
    declared, X = plant((0.25, 0.6)), [0.5, -0.3, 0.8]
    wanted = exact(declared, X, u, 0.0, [1.0])[0]
    silent = lambda x, P: D_HAT * declared.f(P, np.array([u(2.4 * x)[0] * (2.4 * x <= 1), u(x)[1]]))
    held = solve_ivp(silent, (0, 1), X, rtol=1e-6)
    found = RK4(declared, 101)(X, u(grid.nodes(101)), D_HAT)[-1]
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert np.abs(held.y[:, -1] - wanted).max() > 0.1


@pytest.mark.parametrize("method", ONESTEP)
def test_almost_equal_delays_predict_and_control_as_one_delay(method):
    """Two programs: pieces for several delays, whole steps for one, where RK4 reads u to a higher order."""
    close = 2e-3 if method == "rk4" else 1e-12
    several, one = plant((0.6 * (1 - 1e-13), 0.6)), plant((0.6, 0.6))
    assert one.one_delay and not several.one_delay
    loops = [
        simulate(
            p,
            predictors.numerical(method, p, 41),
            D=0.6,
            D_hat=0.55,
            X0=[0.5, -0.3, 0.8],
            t_end=4.0,
            dt=0.013,
            samples=[150],
        )
        for p in (several, one)
    ]
    for a, b in [(loops[0].X, loops[1].X), (loops[0].U, loops[1].U), (loops[0].samples.u, loops[1].samples.u)]:
        np.testing.assert_allclose(a, b, rtol=0, atol=close)
    X, history = loops[0].samples.X, loops[0].samples.u
    P = [predictors.numerical(method, p, 41)(X, history, 0.55, 1.0) for p in (several, one)]
    np.testing.assert_allclose(P[0], P[1], rtol=0, atol=close)


def test_one_delay_keeps_its_program_and_its_identity():
    alone, equal = plant(), plant((0.6, 0.6))
    assert ConstantDelay(alone).sweep(Euler.step).unit == ConstantDelay(equal).sweep(Euler.step).unit
    assert identity(equal) == identity(alone) and identity(alone)["ratios"] == [1.0, 1.0]


@pytest.mark.parametrize("more", [0, 1])
def test_the_prediction_meets_the_plant_at_first_order_in_dt(more):
    """r = 1/2: past its delay an input is the law's value, which the actuator holds. nx = D/dt and one node more."""
    declared, errors = plant((0.2, 0.4)), []
    for late in (40, 80):
        run = RK4(declared, late + more)
        loop = simulate(declared, run, D=0.4, D_hat=0.4, X0=[0.5, -0.3, 0.8], t_end=6.0, dt=0.4 / late)
        errors.append(np.abs(loop.P[:-late] - loop.X[late:])[2 * late :].max())
    assert errors[0] < 5e-4
    assert 0.4 < errors[1] / errors[0] < 0.6


@pytest.mark.parametrize("method", ONESTEP)
def test_an_input_without_delay_is_one_with_almost_none(method):
    """The loop, and the prediction with a law that acts at once; the input of no delay is the law of the state."""
    settings = {"D": 0.6, "D_hat": 0.55, "X0": [0.5, -0.3, 0.8], "t_end": 3.0, "dt": 0.013, "actuator": "history"}
    none, almost = plant((0.0, 0.6)), plant((1e-11, 0.6))
    loops = [simulate(p, predictors.numerical(method, p, 41), **settings) for p in (none, almost)]
    for name in ("X", "U", "P"):
        np.testing.assert_allclose(getattr(loops[0], name), getattr(loops[1], name), rtol=0, atol=1e-8)
    np.testing.assert_allclose(loops[0].U[:, 0], none.kappa(loops[0].X, loops[0].t)[:, 0], rtol=1e-12, atol=1e-12)
    controller = npred.controller(
        none, predictors.numerical(method, none, 41), None, 0.013, D_hat=0.55, actuator="history"
    )
    stepped = np.array([controller.step(X).copy() for X in loops[0].X[:60]])
    np.testing.assert_allclose(stepped, loops[0].U[:60], rtol=0, atol=1e-9)


@pytest.mark.parametrize("delays", [(0.25, 0.6), (0.0, 0.6)])
@pytest.mark.parametrize("nx", [97, 101])
def test_control_is_the_law_of_the_prediction_at_each_delay(nx, delays):
    """U_j = kappa_j(P(r_j), t + r_j D_hat), whether x = 5/12 is a node (nx = 97) or lies between two."""
    declared, X = plant(delays), [0.5, -0.3, 0.8]
    controller = npred.controller(declared, RK4(declared, nx), None, 0.01, D_hat=D_HAT, actuator="measured")
    for k in range(3):
        U = controller.step(X, u(grid.nodes(nx)))
        for c, (r, P) in enumerate(zip(declared.ratios, exact(declared, X, u, 0.01 * k, declared.ratios), strict=True)):
            assert U[c] == pytest.approx(declared.kappa(P, 0.01 * k + r * D_HAT)[c], abs=3e-4)


@pytest.mark.parametrize("first", [0.37, 0.0])
@given(D=st.floats(0.05, 0.9))
@settings(max_examples=20)
def test_each_input_arrives_after_its_own_delay(first, D):
    """X' = U(t - r_j D) without feedback of X: the states are the integrals of the delayed inputs, to rounding."""

    dt, chain = 0.03, INTEGRATORS if first else Plant("at once", type("AtOnce", (Integrators,), {"delays": (0.0, 1.0)}))
    loop = simulate(chain, RK4(chain, 5), D=D, D_hat=0.0, X0=[0.0, 0.0], t_end=2.1, dt=dt, u0=[0.3, -0.4])
    for c, late in enumerate(np.array([first, 1.0]) * D):
        total = np.concatenate([[0.0], np.cumsum(loop.U[:-1, c]) * dt])
        s = loop.t - late
        wanted = np.interp(s, loop.t, total) + (0.3, -0.4)[c] * (late + np.minimum(s, 0.0))
        np.testing.assert_allclose(loop.X[:, c], wanted, rtol=0, atol=1e-8)


def test_batches_equal_single_loops():
    declared, random = plant((0.25, 0.6)), np.random.default_rng(1)
    X0, D, D_hat = random.uniform(-1, 1, (9, 3)), *random.uniform(0.3, 0.6, (2, 9))
    loops = simulate(declared, RK4(declared, 30), D=D, D_hat=D_hat, X0=X0, t_end=2.0, dt=0.017)
    for i in (0, 4, 8):
        one = simulate(declared, RK4(declared, 30), D=D[i], D_hat=D_hat[i], X0=X0[i], t_end=2.0, dt=0.017)
        np.testing.assert_allclose(loops.X[i], one.X, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(loops.energy[i], one.energy, rtol=1e-9)


@pytest.mark.parametrize("nx", [2, 3, 4])
def test_few_nodes(nx):
    """A level history is read exactly on any grid."""
    declared, level = plant((0.25, 0.6)), np.array([0.4, -0.7])
    P, fine = (RK4(declared, k)([0.5, -0.3, 0.8], np.tile(level, (k, 1)), 0.1) for k in (nx, 101))
    np.testing.assert_allclose(P[-1], fine[-1], rtol=0, atol=1e-6)


def test_a_scheme_for_one_delay_says_so():
    with pytest.raises(ConfigError, match=r"picard: expected one delay, plant chain has delays 0.25 s, 0.6 s; use"):
        Picard(plant((0.25, 0.6)))


def test_a_delay_per_input_is_not_taken_for_two_loops():
    """With one start, D = [.4, .9] ran two loops, one of each delay."""
    two, settings = plants.resolve("unicycle"), {"D_hat": 0.9, "t_end": 0.1, "dt": 0.05}
    words = r"D: expected one delay, for plant unicycle declares omega after 0.4167 D, v after 1 D, got .* 2 loops, or"
    with pytest.raises(ConfigError, match=words):
        simulate(two, RK4(two, 11), D=[0.4, 0.9], X0=[1.0, 1.0, 1.0], **settings)
    assert simulate(two, RK4(two, 11), D=[0.4, 0.9], X0=np.ones((2, 3)), **settings).X.shape == (2, 3, 3)
    assert simulate(two, RK4(two, 11), D=[0.4, 0.6, 0.9], X0=np.ones(3), **settings).X.shape == (3, 3, 3)


def test_the_update_law_is_refused_with_distinct_delays():
    declared, law = plant((0.25, 0.6)), DelayAdaptation(gamma=1.0)
    told = "adaptation: expected one delay, plant chain has delays 0.25 s, 0.6 s; "
    with pytest.raises(ConfigError, match=told + "freeze the estimate"):
        simulate(declared, RK4(declared), D=0.6, D_hat=0.6, X0=[0.1, 0, 0], t_end=1.0, adaptation=law)
    with pytest.raises(ConfigError, match=told):
        npred.controller(declared, RK4(declared), law, 0.01, actuator="measured")
    with pytest.raises(ConfigError, match=told):
        law.phi(declared, np.zeros(3), np.zeros((5, 2)), np.zeros((5, 3)), 0.6)


def test_a_compiled_predictor_of_other_delays_is_refused():
    one, other = plant((0.25, 0.6)), plant((0.3, 0.6))
    with pytest.raises(ConfigError, match="predictor: expected one of plant chain"):
        simulate(one, RK4(other), D=0.6, D_hat=0.6, X0=[0.1, 0, 0], t_end=1.0)
