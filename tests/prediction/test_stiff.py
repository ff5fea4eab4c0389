"""Implicit predictors on stiff plants: order and errors by SciPy's Radau, few steps where explicit ones diverge."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from stiff_plants import Lag, Oscillator, Sprung

import npred
from npred.base import grid
from npred.base.errors import ConfigError
from npred.loop.closed_loop import simulate
from npred.plants import Plant

ARM = npred.plant("planar_arm3", friction=20.0)


def command(x, inputs):
    return 2.0 * np.sin(2 * x + np.arange(inputs))


@cache
def radau(plant: Plant, X, D_hat, t=0.0):
    """P(1) by Radau."""

    def f(x, P):
        return D_hat * np.asarray(plant.f(P, command(x, plant.m), t + x * D_hat))

    return solve_ivp(f, (0, 1), X, method="Radau", rtol=1e-10, atol=1e-12).y[:, -1]


def errors(method, plant, X, D_hat, steps, t=0.0):
    exact, found = radau(plant, tuple(X), D_hat, t), []
    for n in steps:
        u = np.stack([command(x, plant.m) for x in grid.nodes(n + 1)])
        found.append(np.abs(npred.predictor(method, plant, n + 1)(X, u, D_hat, t)[-1] - exact).max())
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
    np.testing.assert_allclose(npred.predictor(method, ARM, 6)(X, u, 0.0), np.tile(X, (6, 1)), atol=1e-14)


@pytest.mark.parametrize("method", ["rosenbrock", "semi_implicit"])
def test_many_lanes_are_as_one(method):
    rng = np.random.default_rng(0)
    X, u, D_hat = rng.normal(size=(9, 2)), rng.normal(size=(9, 11, 1)), rng.uniform(0.1, 1.0, 9)
    predictor = npred.predictor(method, SPRUNG, 11)
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
    def short(x, u, t, p, M):
        return [[2.0, 0.0]], [u.u], [p.drag]

    other = Plant("other", type("Other", (Sprung,), {"mechanics": short}))
    spring = npred.plants.Plant("sprung", Sprung, {"spring": 5.0})
    for refused, call in {
        "semi_implicit: expected a plant that declares mechanics": lambda: npred.predictor(
            "semi_implicit", npred.plant("scalar")
        ),
        "semi_implicit: expected one delay": lambda: npred.predictor("semi_implicit", npred.plant("unicycle")),
        r"mechanics .* expected the accelerations of f": lambda: npred.predictor("semi_implicit", spring),
        r"mechanics .* expected to return M \(1, 1\)": lambda: npred.predictor("semi_implicit", other),
        "declares none; use rosenbrock": lambda: simulate(
            npred.plant("scalar"), None, D=0.1, D_hat=0.1, X0=[1.0], t_end=1.0, integrator="semi_implicit"
        ),
    }.items():
        with pytest.raises(ConfigError, match=refused) as error:
            call()
        assert "\n" not in str(error.value)
