"""The paper's plant: what every plant must show; its golden numbers are in test_plants and test_closed_loop."""

import numpy as np
import plant_claims
import pytest
from scipy.linalg import eigh
from scipy.optimize import differential_evolution

import npred
from npred import plants


class TestClaims(plant_claims.Claims):
    plant, D, X0, t_end = plants.resolve("activator_repressor"), 2.0, (0.03, 30.0), 60.0
    pipeline = "paper"


def test_the_theorem_asks_for_a_b_that_is_far_above_that_of_fig_1():
    """b* = C2² 4 s Cf² / (2 λ) of [DAPF, Theorem 3]: with Cf = 1 and the best V = e'Se of the linearised loop 1.4e8."""
    closed, f_U = plants.resolve("activator_repressor").linearised()
    assert f_U.ravel().tolist() == [1.0, 0.0]  # Cf >= 1
    np.testing.assert_allclose(sorted(np.linalg.eigvals(closed)), [-1.0, -0.5], rtol=1e-9)  # λ <= 1

    def b_star(z: np.ndarray) -> float:
        """|e|² <= V is the least eigenvalue 1, C2 twice the largest, and V' <= -λ V."""
        R = np.array([[np.exp(z[0]), z[1]], [0.0, 1.0]])
        S = R @ R.T / np.linalg.eigvalsh(R @ R.T)[0]
        falls = -eigh(S @ closed + closed.T @ S, S, eigvals_only=True)[-1]
        return (2 * np.linalg.eigvalsh(S)[-1]) ** 2 * 4.0 / (2 * falls) if falls > 0 else np.inf

    found = differential_evolution(lambda z: np.log(b_star(z)), [(-3, 8), (-200, 200)], rng=1, tol=1e-9, popsize=30)
    assert np.exp(found.fun) == pytest.approx(1.449e8, rel=1e-3)


def test_the_theorem_as_printed_is_false():
    """[DAPF, Theorem 3] bounds |X(t)|² by β(|X(0)|², t) alone: 0 from rest, for the exact P and the right D_hat."""
    plant = plants.resolve("activator_repressor")
    loop = npred.simulate(
        plant, npred.predictor(plant, "rk4"), D=1.0, D_hat=1.0, X0=plant.equilibrium, u0=[0.01], t_end=20.0, dt=0.01
    )
    assert np.linalg.norm(loop.X - plant.equilibrium, axis=-1).max() == pytest.approx(0.526, rel=0.01)
