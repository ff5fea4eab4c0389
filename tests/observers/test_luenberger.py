"""The Luenberger observer against SciPy, and its poles against those that are asked for."""

import numpy as np
import pytest
from observed import SPRING_A, SPRING_C, Spring, Swing, built_in, correct, follow, plant_of, swing_output
from observed import swing_output_jacobian as output_jacobian
from observed import swing_slope as slope
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are

from npred.errors import ConfigError
from npred.observers import Luenberger
from npred.observers.luenberger import smallest_gain


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_slow_and_unstable_poles_are_mirrored_and_the_others_stay(rate):
    rng = np.random.default_rng(0)
    poles = np.diag([0.7, 0.0, -0.2, -5.0])
    basis = rng.standard_normal((4, 4))
    A, C = basis @ poles @ np.linalg.inv(basis), rng.standard_normal((2, 4))
    L = smallest_gain(A, C, np.array([1.0, 3.0]), rate)
    expected = [-2 * rate - 0.7, -2 * rate, -2 * rate + 0.2, -5.0]
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(A - L @ C)), np.sort(expected), atol=1e-6)


def test_the_gain_is_the_limit_of_scipys_riccati_equation():
    """A double integrator, whose A has no basis of eigenvectors; the weight on the state is small, not 0."""
    A, C, dy = np.array([[0.0, 1.0], [0.0, 0.0]]), np.eye(2)[:1], np.array([0.5])
    P = solve_continuous_are((A + 1.5 * np.eye(2)).T, C.T, 1e-10 * np.eye(2), np.diag(dy**2))
    L = smallest_gain(A, C, dy, 1.5)
    np.testing.assert_allclose(L, P @ C.T / dy**2, rtol=1e-6)
    np.testing.assert_allclose(L[:, 0], [6.0, 9.0], rtol=1e-9)  # (s + 3)²


def test_errors_fade_with_the_poles_as_samples_come_often():
    """Of the linear spring: the map of an error from sample to sample."""
    observer = Luenberger(plant_of(Spring), rate=2.0)
    h, units = 1e-3, []
    for unit in np.eye(2):
        memory = observer.start()
        memory[:2] = unit
        correct(observer, memory, [0.0])
        follow(observer, memory, 0.0, h)
        units.append(memory[:2].copy())
    rates = np.log(np.linalg.eigvals(np.array(units).T).astype(complex)) / h
    designed = -4.0 - np.linalg.eigvals(SPRING_A)
    np.testing.assert_allclose(np.sort_complex(rates), np.sort_complex(designed), rtol=0.02)


def test_between_samples_it_is_the_equation_of_scipy_with_order_four():
    observer, U, d = Luenberger(plant_of(Swing), rate=1.0, X0=[0.6, -0.4], offset=True), 0.7, 0.2
    start = observer.start()
    start[2] = d
    correct(observer, start, [0.3, 0.1])

    def right(_, z):
        x, d, w = z[:2], z[2], z[3:]
        pull = observer.L @ (w - swing_output(x))
        f = slope(x, U + d)
        return [*(f + pull[:2]), pull[2], *(output_jacobian(x) @ f)]

    expected = solve_ivp(right, (0, 0.4), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    errors = []
    for steps in (4, 8, 16):
        memory = start.copy()
        observer.settings[0] = 1.0  # so that no step is divided
        for _ in range(steps):
            follow(observer, memory, U, 0.4 / steps)
        errors.append(np.abs(memory - expected).max())
    assert errors[-1] < 1e-6 and np.allclose(np.log2(np.array(errors[:-1]) / errors[1:])[-1], 4, atol=0.3)


def test_a_long_step_is_divided():
    """RK4 would grow without bound on the fast pole of the gain."""
    observer = Luenberger(plant_of(Spring), rate=20.0)
    memory = observer.start()
    correct(observer, memory, [1.0])
    follow(observer, memory, 0.0, 1.0)
    assert 1.0 / observer.settings[0] > 100 and np.isfinite(memory).all() and np.abs(memory).max() < 30
    fine = observer.start()
    correct(observer, fine, [1.0])
    for _ in range(2000):
        follow(observer, fine, 0.0, 5e-4)
    np.testing.assert_allclose(memory, fine, rtol=0, atol=1e-3)


@pytest.mark.parametrize(("name", "outputs", "dt"), [("chemostat", ("S",), 0.05), ("cart_pole", ("p", "theta"), 0.02)])
def test_it_converges_from_the_outputs_of_a_plant_and_finds_its_offset(name, outputs, dt):
    """The plant is at rest under a constant input of which the observer hears 0.1 less."""
    plant = built_in(name)
    observer = Luenberger(plant, outputs=outputs, offset=True)
    places = [plant.states.index(output) for output in outputs]
    memory, x, u = observer.start(), plant.equilibrium, plant.u_equilibrium
    memory[: plant.n] += 0.3 * observer.sizes.dx
    for _ in range(round(15 / observer.rate / dt)):
        correct(observer, memory, x[places])
        follow(observer, memory, u - 0.1, dt)
    np.testing.assert_allclose(memory[: plant.n], x, atol=1e-3 * observer.sizes.dx.max())
    assert abs(memory[plant.n] - 0.1) < 2e-3


def test_a_missing_output_goes_on_by_the_plant():
    observer = Luenberger(plant_of(Spring), rate=2.0, X0=[0.5, -1.0])
    memory = observer.start()
    for _ in range(20):
        innovation, spread = correct(observer, memory, [np.nan])
        follow(observer, memory, 0.0, 0.05)
    assert np.isnan(innovation).all() and np.isinf(spread).all()
    exact = expm(SPRING_A) @ [0.5, -1.0]
    np.testing.assert_allclose(memory[:2], exact, atol=1e-5)
    np.testing.assert_allclose(memory[3:], SPRING_C @ exact, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Luenberger(built_in("chemostat"), rate=0.0, outputs=("S",)), "rate expected 1/s above 0, got 0.0"),
        (lambda: Luenberger(built_in("chemostat"), rate=[1.0], outputs=("S",)), "rate: expected a real number"),
        (lambda: Luenberger(built_in("unicycle"), outputs=("x", "y")), "take the EKF"),
        (lambda: Luenberger(built_in("cart_pole"), outputs=("theta",)), "rank 2 of 4"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(make, words):
    with pytest.raises(ConfigError) as caught:
        make()
    assert words in str(caught.value) and "\n" not in str(caught.value)
