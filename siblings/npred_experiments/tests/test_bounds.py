"""The bound of the error of U: above the error by SciPy, near it, and closed forms where there are some."""

import numpy as np
import pytest
from guard_samples import BOX, NX, PLANT, Wrong, rows
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

import npred
from npred.base import grid
from npred.base.errors import ConfigError
from npred.plants import Plant
from npred_experiments import bounds
from npred_experiments.bounds import Curve, ErrorBound

NOW = np.zeros(40)
EXACT = {"rtol": 1e-12, "atol": 1e-14}


class Line:
    """x' = a x + u: its logarithmic norm is a, whatever the weight."""

    states, inputs, parameters, box = ("x",), ("v",), {"a": 0.7}, {"x": (-1, 1)}

    def f(x, u, t, p, M):
        return [p.a * x.x + u.v]

    def kappa(x, t, p, M):
        return [-(1 + p.a) * x.x]

    def V(x, t, p, M):
        return x.x**2


def exact(plant, X, u, D_hat):
    """P (nx, n) of one row by SciPy, node by node: between two nodes u is a straight line, and may jump at each."""
    x, P = grid.nodes(len(u)), [X]
    for begin, end in zip(*grid.lines(u), strict=True):
        P.append(solve_ivp(_slope, (0, 1), P[-1], "DOP853", args=(plant, begin, end, D_hat * x[1]), **EXACT).y[:, -1])
    return np.array(P)


def _slope(s, P, plant, begin, end, h):
    return h * np.asarray(plant.f(P, begin + s * (end - begin), 0.0))


@pytest.fixture(scope="module")
def weighted():
    X, u, D_hat = rows()
    return bounds.weight(PLANT, npred.predictor(PLANT, "rk4", NX)(X, u, D_hat), u, D_hat, NOW)


@pytest.mark.parametrize("size", [1e-3, 0.05])
def test_the_bound_is_above_the_error_and_near_it(size, weighted):
    X, u, D_hat = rows()
    P_hat = Wrong(PLANT, error=size)(X, u, D_hat)
    bound = ErrorBound(PLANT, weighted)(P_hat, X, u, D_hat, NOW)
    U = np.stack([PLANT.kappa(exact(PLANT, *row)[-1], 0.0) for row in zip(X, u, D_hat, strict=True)])
    true = np.abs(PLANT.kappa(P_hat[:, -1]) - U).max(axis=1)
    assert (bound >= true * (1 - 1e-9)).all()
    assert np.median(bound / true) < 1.1
    assert np.isfinite(bound).all()


def test_the_bound_holds_where_the_input_jumps_at_its_nodes():
    plant, rng = Plant("line", Line), np.random.default_rng(6)
    X, u, D_hat = rng.normal(size=(20, 1)), rng.normal(size=(20, 11, 1)), np.full(20, 0.15)
    P = np.stack([exact(plant, *row) for row in zip(X, u, D_hat, strict=True)])
    P_hat = P + 1e-5 * grid.nodes(11)[:, None]
    bound = ErrorBound(plant, np.eye(1))(P_hat, X, u, D_hat, np.zeros(20))
    true = np.abs(plant.kappa(P_hat[:, -1]) - plant.kappa(P[:, -1])).max(axis=1)
    assert (bound >= true * (1 - 1e-6)).all()
    assert np.median(bound / true) < 3


def test_an_error_without_bound_is_infinite():
    X, u, D_hat = rows()
    bound = ErrorBound(PLANT, np.eye(2))(Wrong(PLANT, error=3.0)(X, u, D_hat), X, u, D_hat, NOW)
    assert np.isinf(bound).any() and not np.isnan(bound).any()


def test_the_weight_that_is_found_makes_errors_grow_less_than_any_given_one(weighted):
    X, u, D_hat = rows()
    P = npred.predictor(PLANT, "rk4", NX)(X, u, D_hat)

    def mean(W):
        return np.log(ErrorBound(PLANT, W).growth(P, u, D_hat, NOW)).mean()

    assert mean(weighted) < min(mean(np.diag([1, 10.0**-k])) for k in np.linspace(0, 4, 17))
    assert mean(weighted) < mean(np.diag([1, 1 / 57])) < mean(np.eye(2)) / 10


def test_small_errors_grow_by_no_more_than_the_factor(weighted):
    X, u, D_hat = (a[:6] for a in rows())
    growth = ErrorBound(PLANT, weighted).growth(npred.predictor(PLANT, "rk4", NX)(X, u, D_hat), u, D_hat, NOW[:6])
    for k in range(6):
        columns = []
        for unit in np.eye(2):
            step = 1e-6 * np.linalg.solve(weighted, unit)
            ends = [exact(PLANT, X[k] + sign * step, u[k], D_hat[k])[-1] for sign in (1, -1)]
            columns.append(weighted @ (ends[0] - ends[1]) / 2e-6)
        assert np.linalg.norm(np.stack(columns, axis=-1), 2) <= growth[k] * (1 + 1e-3)


def test_a_linear_plant_in_closed_form():
    plant = Plant("line", Line)
    D_hat, u, X = np.array([0.5, 2.0]), np.zeros((2, NX, 1)), np.array([[1.0], [-2.0]])
    P = X[:, None] * np.exp(0.7 * D_hat[:, None, None] * grid.nodes(NX)[:, None])
    bounds = ErrorBound(plant, np.eye(1))
    np.testing.assert_allclose(bounds.growth(P, u, D_hat, np.zeros(2)), np.exp(0.7 * D_hat))
    wrong = P + 0.01 * grid.nodes(NX)[:, None]
    np.testing.assert_allclose(bounds(wrong, X, u, D_hat, np.zeros(2)), 1.7 * 0.01, rtol=0.01)


def straight(u):
    """u (B, nx, m) at the begin, the middle and the end of each cell, straight between the nodes."""
    return u[:, :-1], (u[:, :-1] + u[:, 1:]) / 2, u[:, 1:]


def test_the_curve_is_inside_its_cells_and_its_residual_is_that_of_quadrature():
    X, u, D_hat = (a[:3] for a in rows())
    Q = npred.predictor(PLANT, "heun", NX)(X, u, D_hat)
    curve = Curve(PLANT, Q, X, straight(u), D_hat, NOW[:3])
    x = grid.nodes(NX)
    fine = np.linspace(0, 1, 20 * (NX - 1) + 1)
    for i in range(3):
        slopes = D_hat[i] * PLANT.f(Q[i], u[i])
        spline = CubicHermiteSpline(x, Q[i], slopes)
        for j in range(NX - 1):
            inside = spline(np.linspace(x[j], x[j + 1], 9))
            assert (inside >= curve.lowest[i, j] - 1e-12).all() and (inside <= curve.highest[i, j] + 1e-12).all()
        f = D_hat[i] * PLANT.f(spline(fine), np.interp(fine, x, u[i, :, 0])[:, None])
        whole = (f[:-1] + f[1:]).sum(axis=0) / 2 * fine[1]
        np.testing.assert_allclose(curve.residuals[i, -1], Q[i, -1] - X[i] - whole, atol=2e-3 * np.abs(whole).max())


def test_a_guarded_predictor_bounds_its_models_error():
    X, u, D_hat = rows()
    guarded = npred.guarded(Wrong(PLANT, error=0.01), tolerance=1.0)
    bound = bounds.bound(guarded, X, u, D_hat)
    assert bound.shape == (40,)
    assert bounds.bound(guarded, X[0], u[0], 2.0) > 0
    np.testing.assert_array_equal(bounds.bound(guarded, X.tolist(), u.tolist(), tuple(D_hat), 0), bound)
    flat = bounds.bound(guarded, X[0], u[0, :, 0].tolist(), D_hat[0])
    np.testing.assert_array_equal(flat, bounds.bound(guarded, X[0], u[0], D_hat[0]))
    in_rows = bounds.bound(guarded, X.reshape(8, 5, -1), u.reshape(8, 5, NX, 1), D_hat.reshape(8, 5))
    np.testing.assert_array_equal(in_rows, bound.reshape(8, 5))


def test_plants_without_a_bound_are_refused(tmp_path):
    (tmp_path / "box.py").write_text(BOX)
    for plant in (npred.plant("unicycle"), npred.plant(f"{tmp_path}/box.py:Box")):
        with pytest.raises(ConfigError, match=r"bound: expected .*; take error, an estimate"):
            ErrorBound(plant, np.eye(plant.n))


class Square:
    """x' = r x + x², whose flow from X is r X e / (r + X - X e) with e = exp(r t)."""

    states, inputs, parameters, guess = ("x",), ("v",), {"r": 1e-9, "bend": 1.0}, (0.0,)

    def f(x, u, t, p, M):
        return [p.r * x.x + p.bend * x.x**2 + 0 * u.v]

    def kappa(x, t, p, M):
        return [x.x]


class Steep(Line):
    """The line, with a law that is steeper where x is larger."""

    def kappa(x, t, p, M):
        return [x.x**2]


def of_another_start(plant, X, wrong, monkeypatch):
    """The bound of a prediction from `wrong`, told to be from X, where nothing is corrected first."""
    monkeypatch.setattr(bounds, "SWEEPS", 0)
    u, one = np.zeros((1, NX, 1)), np.ones(1)
    P_hat = npred.predictor(plant, "rk4", NX)(np.array([[wrong]]), u, one)
    return ErrorBound(plant, np.eye(1))(P_hat, np.array([[X]]), u, one, 0 * one)[0]


@pytest.mark.parametrize("a", [0.7, -0.7])
def test_an_error_at_the_start_grows_as_the_linear_plant_lets_it(a, monkeypatch):
    """The residual is 0.1 throughout, and the error of U at x = 1 is (1 + a) 0.1 exp(a) where a > 0."""
    bound = of_another_start(Plant("line", Line, {"a": a}), 0.5, 0.4, monkeypatch)
    exact = (1 + a) * 0.1 * np.exp(a)
    assert exact * (1 - 1e-7) <= bound <= (exact * 1.001 if a > 0 else (1 + a) * 0.2)


@pytest.mark.parametrize(("X", "wrong"), [(0.3, 0.2), (0.8, 0.78), (0.9, 0.89)])
def test_a_bound_holds_where_the_plant_is_steeper_at_P_than_at_what_was_predicted(X, wrong, monkeypatch):
    """x' = x², x(1) = X / (1 - X), from a start that is too low: the slope there is too small for the error."""
    bound = of_another_start(Plant("square", Square), X, wrong, monkeypatch)
    exact, slope = X / (1 - X) - wrong / (1 - wrong), (X - wrong) / (1 - wrong) ** 2
    assert slope < exact < bound < 2.5 * exact


def test_a_bound_holds_where_the_law_is_steeper_at_P_than_at_what_was_predicted(monkeypatch):
    """kappa = x², x(1) = X exp(0.7) from 0.5, predicted from 0.3: 2 Q |Q - P| is less than |Q² - P²|."""
    Q, P = np.exp(0.7) * np.array([0.3, 0.5])
    bound = of_another_start(Plant("steep", Steep), 0.5, 0.3, monkeypatch)
    assert 2 * Q * (P - Q) < P**2 - Q**2 < bound < 1.3 * (P**2 - Q**2)


def test_a_curve_that_turns_within_a_cell_is_inside_it():
    plant, rng, x = Plant("line", Line), np.random.default_rng(8), np.linspace(0, 1, 6)
    Q, u, D_hat = rng.normal(size=(20, 6, 1)), 20 * rng.normal(size=(20, 6, 1)), rng.uniform(0.5, 1.5, 20)
    curve, turns = Curve(plant, Q, Q[:, 0], straight(u), D_hat, np.zeros(20)), 0
    for i in range(20):
        spline = CubicHermiteSpline(x, Q[i], D_hat[i] * plant.f(Q[i], u[i]))
        for j in range(5):
            inside = spline(np.linspace(x[j], x[j + 1], 101))
            assert curve.lowest[i, j] - 1e-12 <= inside.min() and inside.max() <= curve.highest[i, j] + 1e-12
            turns += inside.max() > Q[i, j : j + 2].max() + 0.1
    assert turns > 20
