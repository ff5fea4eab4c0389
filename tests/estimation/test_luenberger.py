"""The Luenberger observer against SciPy; and promises of every observer: it stays at the truth, and knows no units."""

import numpy as np
import pytest
from observed import (
    SPRING_A,
    SPRING_C,
    Spring,
    Swing,
    Tide,
    built_in,
    correct,
    follow,
    plant_of,
    swing_in,
    swing_output,
)
from observed import swing_output_jacobian as output_jacobian
from observed import swing_slope as slope
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are

import npred
from npred.base.errors import ConfigError
from npred.estimation.observers import EKF, Luenberger
from npred.estimation.observers.luenberger import smallest_gain


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
        x, d, w = z[:2], z[2], z[3:5]
        pull = observer.L @ (w - swing_output(x))
        f = slope(x, U + d)
        return [*(f + pull[:2]), pull[2], *(output_jacobian(x) @ f), 0.0, 0.0]

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
    np.testing.assert_allclose(memory[3:4], SPRING_C @ exact, atol=1e-5)


def test_an_output_half_a_range_from_the_last_one_is_not_used_and_the_first_one_may_be_six():
    """Whatever the state says; a right one after a wrong one, which was taken, is used in any case."""
    observer = Luenberger(plant_of(Spring), rate=2.0)
    memory, half = observer.start(), float(observer.sizes.dy[0])

    def uses(Y):
        before = memory.copy()
        _, spread = correct(observer, memory, [Y], gate=6.0)
        used = bool(np.isinf(spread[0]))
        assert memory[3] == Y if used else np.array_equal(memory, before)
        return used

    assert not uses(6.01 * half) and uses(5.99 * half) and uses(0.0)  # the first two were wrong
    assert uses(0.0) and not uses(1.01 * half) and not uses(-1.01 * half)
    assert uses(0.99 * half) and uses(-0.2 * half)  # the box of a wrong one holds what was before it


def referee(observer, X, times, U, D, every):
    """x and the observer's x at the times, the outputs being measured at each `every`-th; and its x without the pull
    between samples, by SciPy with the input U[k - D] from times[k] on.
    """

    def right(_, z, u):
        x, o, w = z[:2], z[2:4], z[4:]
        f = slope(o, u)
        return [*slope(x, u), *(f + observer.L @ (w - swing_output(o))), *(output_jacobian(o) @ f)]

    z, model, rows = np.array([*X, 0.0, 0.0, 0.0, 0.0]), np.zeros(2), []
    for k in range(len(times)):
        if k % every == 0:
            z[4:], model = swing_output(z[:2]), z[2:4]
        rows.append([*z[:4], *model])
        u, span = (U[k - D] if k >= D else 0.0), (0.0, times[1] - times[0])
        z = solve_ivp(right, span, z, args=(u,), method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        model = solve_ivp(lambda _, x, u: slope(x, u), span, model, args=(u,), rtol=1e-10, atol=1e-12).y[:, -1]
    return np.array(rows).T.reshape(3, 2, -1).transpose(0, 2, 1)


@pytest.mark.parametrize(("every", "share"), [(1, 1.0), (8, 0.95), (25, 0.85)])
def test_in_a_controller_the_state_is_the_observers_also_between_samples(every, share):
    """Against SciPy; the share of the error that is left of that of the model alone between two samples."""
    plant, dt, D = plant_of(Swing), 0.02, 10
    observer, x = Luenberger(plant, rate=1.0, X0=[0.0, 0.0]), np.array([0.6, -0.4])
    controller = npred.controller(
        plant, npred.predictor(plant, "heun", nx=11), None, dt, D_hat=D * dt, actuator="history", observer=observer
    )
    times, U, X_hat = np.arange(151) * dt, [], []
    for k, t in enumerate(times):
        U.append(float(controller.step(swing_output(x) if k % every == 0 else None, t=t)[0]))
        X_hat.append(controller.X_hat)
        u = U[k - D] if k >= D else 0.0
        x = solve_ivp(lambda _, x, u: slope(x, u), (0, dt), x, args=(u,), rtol=1e-10, atol=1e-12).y[:, -1]
    X, expected, model = referee(observer, [0.6, -0.4], times, U, D, every)
    np.testing.assert_allclose(X_hat, expected, atol=2e-6)
    rms = [np.sqrt(((a - X) ** 2).mean()) for a in (expected, model)]
    print(f"every {every}: rms {rms[0]:.3f}, the model alone between samples {rms[1]:.3f}")
    assert rms[0] <= share * rms[1]


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


KINDS = pytest.mark.parametrize("kind", [EKF, Luenberger])


@KINDS
def test_from_the_truth_it_stays_there(kind):
    """Of a plant and an output that depend on time, with an input that switches within the steps."""
    plant, h, every = plant_of(Tide), 0.05, 6
    observer = kind(plant, X0=[0.4, -0.3])
    memory, X, worst = observer.start(), np.array([0.4, -0.3]), 0.0
    for k in range(60):
        t = 0.7 + k * h
        if k % every == 0:
            correct(observer, memory, plant.output(X, t), t)
        follow(observer, memory, 1.0, h, t, after=-0.5, share=0.4)
        for begin, end, U in ((t, t + 0.4 * h, 1.0), (t + 0.4 * h, t + h, -0.5)):
            f = lambda s, x, U=U: plant.f(x, np.array([U]), s)
            X = solve_ivp(f, (begin, end), X, rtol=1e-10, atol=1e-12).y[:, -1]
        worst = max(worst, np.abs(memory[:2] - X).max())
    assert worst < 1e-5


@KINDS
def test_its_defaults_do_not_depend_on_units(kind):
    """A pendulum in picoseconds, milliradians and other units: the same estimates, and the same offset."""
    found = []
    for units in ({}, {"time": 1e12, "angle": 1e3, "rate": 7.0, "input": 0.01, "outputs": (50.0, 0.02)}):
        of = {"time": 1.0, "angle": 1.0, "rate": 1.0, "input": 1.0, "outputs": (1.0, 1.0)} | units
        observer = kind(swing_in(**units), offset=True)
        memory, rng = observer.start(), np.random.default_rng(0)
        sizes = np.array([of["angle"], of["rate"], of["input"]])
        for _ in range(12):
            correct(observer, memory, rng.uniform(-0.5, 0.5, 2) * of["outputs"])
            follow(observer, memory, rng.uniform(-1, 1) * of["input"], 0.05 * of["time"])
            found.append(memory[:3] / sizes)
    np.testing.assert_allclose(found[12:], found[:12], rtol=1e-6, atol=1e-8)
    assert np.ptp(found, axis=0).min() > 0.01


def test_the_filter_beside_it_has_its_outputs_also_where_they_are_some_of_the_plants():
    class Two:
        states, inputs, outputs = ("x", "v"), ("u",), ("place", "pace")
        box = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}
        f = lambda x, u, t, p, M: [x.v, u.u - x.x - x.v]
        kappa = lambda x, t, p, M: [-x.v]
        output = lambda x, t, p, M: [x.x, x.v]

    plant = npred.plant(Two)
    for outputs in (None, ("place",), ("x",), ("place", "v")):
        one = npred.observers.Luenberger(plant, outputs=outputs)
        assert one.filter.outputs == one.outputs
