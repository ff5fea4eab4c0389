"""The unicycle: two delays and a law that depends on time, against independent solvers and the literature's numbers."""

import numpy as np
import plant_claims
import pytest
from scipy.integrate import solve_ivp

from npred import plants
from npred.base.registry import METHODS
from npred.loop import metrics
from npred.loop.closed_loop import simulate
from npred.prediction.methods import RK4

PLANT = plants.resolve("unicycle")
D, EARLY = 0.6, 0.25
START = (1.0, 1.0, 1.0)
ONESTEP = [name for name in METHODS.builtin if name not in ("picard", "semi_implicit", "rollout")]


def test_law_and_kinematics_are_those_of_the_literature():
    """Typed again from the formulas in p and q."""
    for X, t in zip(plant_claims.box(PLANT, 20), np.linspace(0, 5, 20), strict=True):
        x, y, theta = X
        p, q = x * np.cos(theta) + y * np.sin(theta), x * np.sin(theta) - y * np.cos(theta)
        omega = -5 * p**2 * np.cos(3 * t) - p * q * (1 + 25 * np.cos(3 * t) ** 2) - theta
        v = -p + 5 * q * (np.sin(3 * t) - np.cos(3 * t)) + q * omega
        np.testing.assert_allclose(PLANT.kappa(X, t), [omega, v], rtol=1e-13)
        np.testing.assert_allclose(PLANT.f(X, np.array([omega, v])), [v * np.cos(theta), v * np.sin(theta), omega])
        np.testing.assert_allclose(PLANT.kappa(X, t + PLANT.period), [omega, v], rtol=1e-9)


def test_it_rests_at_the_origin_at_all_times_and_its_prediction_needs_the_clock():
    assert PLANT.clocked and not PLANT.one_delay and PLANT.rest
    np.testing.assert_array_equal(np.array(PLANT.rest[0]), np.zeros(3))
    np.testing.assert_array_equal(np.array(PLANT.rest[1]), np.zeros(2))


def test_its_pipeline_fits():
    plant_claims.Claims.test_its_pipeline_fits(claims())


def claims():
    made = plant_claims.Claims()
    made.plant = PLANT  # type: ignore[misc]
    return made


def test_derivatives_equal_differences():
    plant_claims.derivatives_equal_differences(PLANT)


@pytest.mark.parametrize("method", ONESTEP)
def test_predictor_order(method):
    """Intervals that never have x = 5/12 as a node."""
    plant_claims.has_its_order(PLANT, method, D, of_reading=2)  # where each input has a delay of its own


def test_the_plant_in_the_loop_is_that_of_an_independent_solver():
    """The recorded inputs, each after its own delay, through DOP853."""
    loop = simulate(PLANT, RK4(PLANT, 49), D=D, D_hat=D, X0=START, t_end=10.0)
    np.testing.assert_allclose(loop.X, plant_claims.replayed(PLANT, loop, (EARLY, D)), rtol=0, atol=1e-6)


def golden_loop(t_end, dt):
    """X (nt, 3) of the loop whose U_j is kappa_j of the exact prediction, held over dt; no predictor of npred's.

    Until its delay the turning rate that the prediction meets is held history, as for the robot: P(r_1) is the state
    itself, EARLY later. From there on it is the law of the prediction, the speed still being held history.
    """
    early, late = round(EARLY / dt), round(D / dt)
    X, U = [np.array(START)], {}
    for k in range(-early, round(t_end / dt) - early):
        if k >= 0:  # at t = k dt, with the state known up to t + EARLY
            ahead = np.array(X[k + early])
            U[k, 0] = PLANT.kappa(ahead, k * dt + EARLY)[0]
            for i in range(k + early, k + late):
                ahead = _step(ahead, i * dt, dt, lambda t, P, i=i: [PLANT.kappa(P, t)[0], U.get((i - late, 1), 0.0)])
            U[k, 1] = PLANT.kappa(ahead, k * dt + D)[1]
        i = k + early  # the step that the robot takes next
        held = [U.get((i - early, 0), 0.0), U.get((i - late, 1), 0.0)]
        X.append(_step(X[i], i * dt, dt, lambda t, P, held=held: held))
    return np.array(X)


def _step(X, t, dt, inputs):
    return solve_ivp(
        lambda s, P: PLANT.f(P, np.array(inputs(s, P))), (t, t + dt), X, "DOP853", rtol=1e-10, atol=1e-12
    ).y[:, -1]


def test_the_loop_is_the_golden_one():
    """RK4 sees the jumps of held inputs as slopes a cell wide: of first order in the cell, and 1e-6 extrapolated."""
    golden = golden_loop(5.0, 0.05)
    coarse, fine = (
        simulate(PLANT, RK4(PLANT, cells + 1), D=D, D_hat=D, X0=START, t_end=5.0, dt=0.05).X for cells in (1200, 2400)
    )
    assert np.abs(fine - golden).max() / np.abs(coarse - golden).max() == pytest.approx(0.5, abs=0.02)
    np.testing.assert_allclose(2 * fine - coarse, golden, rtol=0, atol=1e-6)


def test_the_exact_predictors_loop_converges_from_its_box():
    """As 1/sqrt(t): |X| sqrt(t) stays below a half, from everywhere; 1 % of a metre takes half an hour."""
    X0 = plant_claims.box(PLANT, 8)
    loops = simulate(PLANT, RK4(PLANT, 25), D=D, D_hat=D, X0=X0, t_end=2500.0, dt=0.05, every=20)
    late = loops.t > 20
    size = np.linalg.norm(loops.X[:, late], axis=-1)
    assert (size * np.sqrt(loops.t[late])).max() < 0.5
    assert metrics.radius(loops, np.zeros(3)).max() < 0.01


def test_without_the_predictor_it_does_not():
    """U = kappa(X(t)), applied late: lost from nine tenths of the box, the literature's start among them."""
    X0 = np.vstack([START, plant_claims.box(PLANT, 32)])
    free = [(-1e300, 1e300)] * 2
    loops = simulate(PLANT, RK4(PLANT, 5), D=D, D_hat=0.0, X0=X0, t_end=60.0, every=20, input_bounds=free)
    lost = ~np.isfinite(loops.X[:, -1]).all(axis=-1)
    assert lost[0] and lost.mean() > 0.9
