"""The published law for an unmeasured actuator: its formula against NumPy, and what it does to the chemostat."""

import numpy as np
import pytest

import npred
from npred.base.errors import ConfigError

PLANT = npred.plant("chemostat")


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
        PLANT, npred.predictor("rk4", PLANT, nx=101), D=D, D_hat=D_hat, X0=[2.0, 2.0], t_end=60.0, u0="law",
        adaptation=npred.L1Adaptation(gamma=1.0, bounds=(0.8, 2.0)), actuator="history",
    )  # fmt: skip


def test_it_brings_the_chemostat_to_rest_from_near_the_delay():
    run = chemostat([1.6, 1.4], 1.8)
    assert np.abs(run.X[:, -200:] - PLANT.equilibrium).max() < 2e-6  # 1.2e-6, still falling
    assert abs(run.D_hat[0, -1] - 1.6) < 0.1  # 1.5959 in the published discretisation, corrected


def test_plants_without_one_delay_to_estimate_are_refused():
    with pytest.raises(ConfigError, match="expected one delay, plant unicycle has delays"):
        npred.L1Adaptation().check(npred.plant("unicycle"))
