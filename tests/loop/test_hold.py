"""What a law loses because its command is held, against loops of matrices; the delay has no part in it."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are

import npred
from npred.loop import control_step, hold
from npred.plants import Plant


class Cart:
    """A cart that is pushed. RK4 is exact for commands that are held."""

    states, inputs, box = ("x", "v"), ("u",), {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}
    parameters = {"k1": 1.0, "k2": 2.0}
    f = lambda x, u, t, p, M: [x.v, u.u]
    kappa = lambda x, t, p, M: [-p.k1 * x.x - p.k2 * x.v]


A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])


def held(dt):
    """A_d and B_d."""
    step = expm(dt * np.block([[A, B], [np.zeros((1, 3))]]))
    return step[:2, :2], step[:2, 2:]


@pytest.mark.parametrize("steps", [1, 2, 3])
@pytest.mark.parametrize("dt", [0.2, 1.0, 3.0])
def test_a_delay_of_few_steps_is_predicted_exactly_and_a_law_for_held_commands_stands(steps, dt):
    A_d, B_d = held(dt)
    S = solve_discrete_are(A_d, B_d, np.eye(2), np.eye(1))
    K = np.linalg.solve(np.eye(1) + B_d.T @ S @ B_d, B_d.T @ S @ A_d)[0]
    plant, D = Plant("cart", Cart, {"k1": K[0], "k2": K[1]}), steps * dt
    run = npred.simulate(
        plant, npred.predictor(plant, "rk4", 61), D=D, D_hat=D, X0=[0.5, -0.2], t_end=40 * dt, dt=dt,
        actuator="history", u0=[0.0],
    )  # fmt: skip
    x, commands, exact = np.array([0.5, -0.2]), [0.0] * steps, []
    for _ in run.t:
        exact.append(x)
        ahead = x
        for u in commands[-steps:]:
            ahead = A_d @ ahead + B_d[:, 0] * u
        commands.append(-K @ ahead)
        x = A_d @ x + B_d[:, 0] * commands[-steps - 1]
    np.testing.assert_allclose(run.X, exact, rtol=0, atol=5e-11)
    assert np.abs(run.X[-1]).max() < 1e-2 * np.abs(run.X).max()


@settings(max_examples=20, deadline=None)
@given(st.floats(0.3, 3.0), st.floats(0.5, 3.0), st.floats(0.01, 0.5))
@example(0.43, 2.93, 0.47)  # a mode that changes its sign with each step
def test_the_loss_is_that_of_small_states(k1, k2, dt):
    """Against matrices: the largest difference from any corner of the box, whatever the delay."""
    A_d, B_d = held(dt)
    K = -np.array([[k1, k2]])
    ends = A + B @ K
    lost = hold.loss(Plant("cart", Cart, {"k1": k1, "k2": k2}), dt)
    if np.abs(np.linalg.eigvals(A_d + B_d @ K)).max() >= 1:
        assert lost == np.inf
        return
    corners, far = np.array([[1.0, 1.0], [1.0, -1.0]]).T, np.zeros((2, 2))
    x, ideal = corners, expm(ends * dt)
    y = x
    for _ in range(int(hold.LONG / -np.linalg.eigvals(ends).real.max() / dt)):
        x, y = (A_d + B_d @ K) @ x, ideal @ y
        far = np.maximum(far, [np.abs(x - y).max(axis=1), np.abs(y).max(axis=1)])
    expected = (far[0] / np.maximum(far[1], 1.0)).max()
    assert lost == pytest.approx(expected, rel=0.05, abs=1e-4)


def test_the_loss_is_proportional_to_the_step_and_free_of_units():
    """In another unit of time, and of a state, it is the same; of an unknown law it is none."""
    plant = npred.plant("van_der_pol")
    assert hold.loss(plant, 0.01) == pytest.approx(0.01 * hold.per_time(plant), rel=0.05)
    fast = Plant("fast", type("Fast", (Cart,), {
        "box": {"x": (-1e9, 1e9), "v": (-1e12, 1e12)}, "f": lambda x, u, t, p, M: [x.v, 1e12 * u.u],
        "kappa": lambda x, t, p, M: [-p.k1 * 1e-6 * x.x - p.k2 * 1e-9 * x.v],
    }))  # fmt: skip
    slow = Plant("cart", Cart)
    same = type("Slow", (Cart,), {"box": {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}})
    assert hold.loss(fast, 1e-4) == pytest.approx(hold.loss(Plant("slow", same), 0.1), rel=1e-4)
    assert hold.loss(Plant("lost", Cart, {"k1": -1.0}), 0.1) == 0.0 and control_step.usual(0.0, slow) < 1


@pytest.mark.parametrize("seed", range(10))
def test_a_mode_that_does_not_move_has_no_part_in_the_loss(seed):
    """z' = -z + u, y' = -2 y + u and a constant, in mixed states: rounding moves the rate of the constant off 0."""
    mixed = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    A_m, B_m, K_m = mixed @ np.diag([0.0, -1.0, -2.0]) @ mixed.T, mixed @ [0.0, 1.0, 1.0], -0.5 * mixed[:, 1]

    class Mixed:
        states, inputs = ("a", "b", "c"), ("u",)
        box = dict.fromkeys(states, (-1.0, 1.0))
        f = lambda x, u, t, p, M: [row @ list(x) + b * u.u for row, b in zip(A_m, B_m, strict=True)]
        kappa = lambda x, t, p, M: [K_m @ list(x)]

    plant = Plant("mixed", Mixed)
    step = expm(0.1 * np.block([[A_m, B_m[:, None]], [np.zeros((1, 4))]]))[:3]
    one, ideal = step[:, :3] + np.outer(step[:, 3], K_m), expm(0.1 * (A_m + np.outer(B_m, K_m)))
    powers = [(np.linalg.matrix_power(one, k), np.linalg.matrix_power(ideal, k)) for k in range(int(hold.LONG / 0.15))]
    far = np.max([np.abs(a - b).sum(axis=1) for a, b in powers], axis=0)
    expected = (far / np.max([np.abs(b).sum(axis=1) for _, b in powers], axis=0)).max()
    assert hold.loss(plant, 0.1) == pytest.approx(expected, rel=0.05)
    assert hold.loss(plant, 0.01) == pytest.approx(0.1 * expected, rel=0.1)
    assert control_step.usual(1.0, plant) == 0.01
