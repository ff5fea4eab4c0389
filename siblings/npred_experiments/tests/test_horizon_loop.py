"""The loop with an observer: the published ranges, its limit for small steps, and SciPy on the delayed equations."""

import numpy as np
import pytest
from scipy.integrate import quad_vec, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from npred_experiments import horizon_loop as experiment
from npred_experiments.horizons import draws, inverse, late, rate

FIRST, SECOND = draws()
A, B, C, K, L = experiment.A, experiment.B, experiment.C, experiment.K, experiment.L


def test_exponentials_and_poles():
    assert experiment.flow(0.7) == pytest.approx(expm(0.7 * A), rel=1e-13)
    assert experiment.driven(np.array([0.7]))[0] == pytest.approx(expm(0.7 * A) @ B, rel=1e-13)
    assert experiment._decay(np.array(0.7)) == pytest.approx(expm(0.7 * (A - np.outer(L, C))), rel=1e-12)
    assert np.sort(np.linalg.eigvals(A + np.outer(B, K)).real) == pytest.approx([-2, -1])
    printed = np.array([[0.0, 1.0], [1.0, 2.0]])  # in the article, for the figure of another A
    assert np.abs(printed - A).max() == 1.0


def test_the_published_loop_is_the_figures():
    loop = experiment.published_loop()
    assert loop.Z[-1] == pytest.approx([-0.4277015, 0.3462370], abs=6e-8)
    assert [*loop.Z.min(axis=0), *loop.Z.max(axis=0)] == pytest.approx(
        [-182.8885, -166.8311, -0.3074, 68.6396], abs=6e-5
    )
    assert (loop.U.min(), loop.U.max()) == pytest.approx((-771.52, 729.42), abs=6e-3)
    assert (loop.horizon.min(), loop.horizon.max()) == pytest.approx((0.3244, 0.6850), abs=6e-5)


def test_its_limit_for_small_steps_is_the_loop_as_meant():
    end = experiment.meant().Z[-1]
    coarse, fine = (np.linalg.norm(experiment.published_loop(dt, 101).Z[-1] - end) for dt in (0.004, 0.002))
    assert coarse / fine == pytest.approx(2.0, abs=0.2)


def test_the_loop_as_meant_obeys_the_delayed_equations():
    """Its commands, given to plant and observer with their delays, lead SciPy to its states and to K P."""
    begin, end = experiment.first_arrival(), 5.0
    loop = experiment.meant(float(inverse(FIRST, np.array([end]))[0]))
    s = np.linspace(begin, float(inverse(FIRST, np.array([end]))[0]), len(loop.Z))
    commands = CubicSpline(late(FIRST, s), loop.U)

    def sent(t):
        return float(commands(t)) if t >= late(FIRST, begin) else 0.0

    def plant(t, Z):
        return A @ Z + B * sent(late(FIRST, t))

    exact = {"rtol": 1e-9, "atol": 1e-9, "dense_output": True, "max_step": 0.02}
    drift = solve_ivp(plant, (0, begin), experiment.BEFORE, **exact)
    driven = solve_ivp(plant, (begin, s[-1]), drift.y[:, -1], **exact)
    assert pytest.approx(loop.Z[::500], abs=1e-4) == driven.sol(s[::500]).T

    def state(t):
        return experiment.BEFORE if t < 0 else drift.sol(t) if t < begin else driven.sol(t)

    def observer(t, xi):
        at = late(SECOND, t)
        return rate(SECOND, t) * (A @ xi + B * sent(late(FIRST, at)) + L * (C @ state(at) - C @ xi))

    observed = solve_ivp(observer, (0, end), experiment.GUESS, **exact)
    for t in (1.0, 2.5, end):
        at, arrival = late(SECOND, t), float(inverse(FIRST, np.array([t]))[0])
        Z_hat = expm(A * (t - at)) @ observed.sol(t)
        Z_hat = Z_hat + quad_vec(lambda tau, t=t: expm(A * (t - tau)) @ B * sent(late(FIRST, tau)), at, t)[0]

        def on_the_way(theta, arrival=arrival):
            lands = float(inverse(FIRST, np.array([theta]))[0])
            return expm(A * (arrival - lands)) @ B * sent(theta) / rate(FIRST, lands)

        P = expm(A * (arrival - t)) @ Z_hat
        P = P + quad_vec(on_the_way, max(late(FIRST, t), late(FIRST, begin)), t, epsabs=1e-6)[0]
        assert pytest.approx(sent(t), abs=2e-4) == K @ P
