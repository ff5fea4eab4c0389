"""Implicit predictors on stiff plants: order and errors by SciPy's Radau, and the elimination in them against NumPy."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from stiff_plants import Lag, Oscillator, Sprung

import npred
from npred.base import grid
from npred.base.errors import ConfigError
from npred.formulas import tape
from npred.formulas.trace import python
from npred.loop.closed_loop import simulate
from npred.plants import Plant
from npred.prediction.methods import rosenbrock

ARM = npred.plant("planar_arm3", friction=20.0)


def command(x, inputs):
    return 2.0 * np.sin(2 * x + np.arange(inputs))


@cache
def radau(plant: Plant, X, D_hat, t=0.0):
    """P(1) by Radau."""

    f = lambda x, P: D_hat * np.asarray(plant.f(P, command(x, plant.m), t + x * D_hat))
    return solve_ivp(f, (0, 1), X, method="Radau", rtol=1e-10, atol=1e-12).y[:, -1]


def errors(method, plant, X, D_hat, steps, t=0.0):
    exact, found = radau(plant, tuple(X), D_hat, t), []
    for n in steps:
        u = np.stack([command(x, plant.m) for x in grid.nodes(n + 1)])
        found.append(np.abs(npred.predictor(plant, method, n + 1)(X, u, D_hat, t)[-1] - exact).max())
    return np.array(found)


SPRUNG = Plant("sprung", Sprung)
# Starts on the slow manifold, where stiff plants spend their time; a transient is shorter than any step here.
CASES = {
    "geared arm": ("rosenbrock", ARM, [0.3, 0.7, 1.0, 0.0, 0.0, 0.0], 1.0, 0.0, [80, 160, 320]),
    "Van der Pol": ("rosenbrock", Plant("oscillator", Oscillator), [2.0, -0.0033], 0.5, 0.0, [5, 10, 20, 40]),
    "linear, clocked": ("rosenbrock", Plant("lag", Lag), [1.0 + np.cos(0.3), 0.2], 1.0, 0.3, [5, 10, 20, 40]),
    "geared arm by its mechanics": ("semi_implicit", ARM, [0.3, 0.7, 1.0, 0.0, 0.0, 0.0], 1.0, 0.0, [5, 10, 20, 40]),
    "slow arm by its mechanics": (
        "semi_implicit", npred.plant("planar_arm2"), [0.3, 0.7, 0.0, 0.0], 0.5, 0.0, [50, 100, 200]
    ),
    "sprung": ("semi_implicit", SPRUNG, [0.0, 0.5], 1.0, 0.0, [5, 10, 20, 40]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_fitted_order_on_stiff_plants(name):
    method, plant, X, D_hat, t, steps = CASES[name]
    found = errors(method, plant, X, D_hat, steps, t)
    assert -np.polyfit(np.log(steps), np.log(found), 1)[0] == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("method", ["rosenbrock", "semi_implicit"])
def test_ten_steps_serve_where_explicit_methods_need_hundreds(method):
    X = [0.3, 0.7, 1.0, 0.0, 0.0, 0.0]
    assert errors(method, ARM, X, 1.0, [10])[0] < 1e-3
    with np.errstate(all="ignore"):
        assert not errors("rk4", ARM, X, 1.0, [100])[0] < 1e3


@pytest.mark.parametrize("method", ["rosenbrock", "semi_implicit"])
def test_without_a_delay_the_prediction_is_the_state(method):
    X, u = np.array([0.3, 0.7, 1.0, 0.1, 0.0, -0.2]), np.ones((6, 3)) * grid.nodes(6)[:, None]
    np.testing.assert_allclose(npred.predictor(ARM, method, 6)(X, u, 0.0), np.tile(X, (6, 1)), atol=1e-14)


@pytest.mark.parametrize("method", ["rosenbrock", "semi_implicit"])
def test_many_lanes_are_as_one(method):
    rng = np.random.default_rng(0)
    X, u, D_hat = rng.normal(size=(9, 2)), rng.normal(size=(9, 11, 1)), rng.uniform(0.1, 1.0, 9)
    predictor = npred.predictor(SPRUNG, method, 11)
    for row, P in zip(zip(X, u, D_hat, strict=True), predictor(X, u, D_hat), strict=True):
        np.testing.assert_allclose(predictor(*row), P, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("integrator", ["rosenbrock", "semi_implicit"])
def test_a_stiff_plant_advances_by_control_steps_longer_than_its_time_constants(integrator):
    """Its slow motion: drag q' = U(t - D) - sin q, held inputs, drag >> 1."""
    loop = simulate(SPRUNG, None, D=0.1, D_hat=0.1, X0=[0.0, 0.5], t_end=5.0, dt=0.05, integrator=integrator)
    slow = solve_ivp(lambda t, q: -np.sin(q) / 3000.0, (0, 5), [0.5], rtol=1e-9).y[0, -1]
    assert abs(loop.X[-1, 1] - slow) < 1e-6
    with np.errstate(all="ignore"):
        lost = simulate(SPRUNG, None, D=0.1, D_hat=0.1, X0=[0.0, 0.5], t_end=5.0, dt=0.05)
    assert not np.isfinite(lost.X[-1]).all()


@pytest.mark.parametrize("name", ["cart_pole", "planar_arm2", "planar_arm7"])
def test_the_mechanics_that_plants_declare_are_those_of_f(name):
    npred.plant(name).check_mechanics()


def test_refusals_are_one_line_each(tmp_path):
    short = lambda x, u, t, p, M: ([[2.0, 0.0]], [u.u], [p.drag])
    other = Plant("other", type("Other", (Sprung,), {"mechanics": short}))
    spring = npred.plants.Plant("sprung", Sprung, {"spring": 5.0})
    for refused, call in {
        "semi_implicit: expected a plant that declares mechanics": lambda: npred.predictor(
            npred.plant("scalar"), "semi_implicit"
        ),
        "semi_implicit: expected one delay": lambda: npred.predictor(npred.plant("unicycle"), "semi_implicit"),
        r"mechanics .* expected the accelerations of f": lambda: npred.predictor(spring, "semi_implicit"),
        r"mechanics .* expected to return M \(1, 1\)": lambda: npred.predictor(other, "semi_implicit"),
        "declares none; use rosenbrock": lambda: simulate(
            npred.plant("scalar"), None, D=0.1, D_hat=0.1, X0=[1.0], t_end=1.0, integrator="semi_implicit"
        ),
    }.items():
        with pytest.raises(ConfigError, match=refused) as error:
            call()
        assert "\n" not in str(error.value)


@given(seed=st.integers(0, 10**6), size=st.integers(1, 7), sparse=st.floats(0.0, 0.6))
@settings(max_examples=80, deadline=None)
def test_solutions_are_those_of_numpy(seed, size, sparse):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(size, size)), rng.normal(size=(2, size))
    A[rng.random((size, size)) < sparse] = 0.0
    A += np.roll(np.eye(size), 1, axis=1) * 3.0  # regular without its diagonal
    if np.linalg.cond(A) > 1e6:
        return
    solve = rosenbrock.solver(A.tolist())
    for right in b:
        np.testing.assert_allclose(solve(right.tolist()), np.linalg.solve(A, right), rtol=1e-8, atol=1e-8)


def test_a_pivot_that_vanishes_is_exchanged_in_a_traced_program():
    """The text knows no values: the same program serves matrices with another largest entry in each column."""
    on = tape.Tape()
    entries, b = on.inputs("a", 9), on.inputs("b", 3)
    y = rosenbrock.solver([entries[:3], entries[3:6], entries[6:]])(b)
    program = python(y, [*tape.names("a", 9), *tape.names("b", 3)])
    rng = np.random.default_rng(3)
    for shift in range(3):
        A = np.roll(np.diag([2.0, -3.0, 5.0]), shift, axis=0) + np.roll(np.diag([0.0, 1e-3, 0.0]), 1, axis=1)
        right = rng.normal(size=3)
        np.testing.assert_allclose(program(*A.ravel(), *right), np.linalg.solve(A, right), rtol=1e-12)


def test_rows_that_are_known_to_be_of_the_identity_cost_no_search_and_zeros_no_product():
    on = tape.Tape()
    h, spring, drag, b = (*on.inputs("c", 3), on.inputs("b", 2))
    y = rosenbrock.solver([[1.0, -h], [h * spring, 1.0 + h * drag]])(b)
    operations = [op for op, _ in on.nodes]
    assert "where" not in operations and operations.count("div") == 1
    program = python(y, ["c0", "c1", "c2", "b0", "b1"])
    expected = np.linalg.solve([[1.0, -0.5], [1.0, 4.0]], [1.0, 2.0])
    assert program(0.5, 2.0, 6.0, 1.0, 2.0) == pytest.approx(expected)
