"""The extended Kalman filter against SciPy and against formulas with matrices, which share no code with it."""

import pickle

import numpy as np
import pytest
from driven import driven
from hypothesis import given, settings
from hypothesis import strategies as st
from observed import (
    SPRING_A,
    SPRING_B,
    SPRING_C,
    Spring,
    Swing,
    built_in,
    correct,
    follow,
    plant_of,
    swing_jacobian,
    swing_output,
    swing_output_jacobian,
    swing_slope,
)
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

import npred
from npred.base.errors import ConfigError
from npred.estimation.observers import EKF
from npred.estimation.observers.ekf import factors

Q, P0 = np.array([[0.2, 0.05], [0.05, 0.4]]), np.array([[0.5, -0.1], [-0.1, 0.3]])
CHEMOSTAT = {"outputs": ("S",), "Q": [0.01, 0.02], "R": 1e-4}


def swing(**settings):
    return EKF(plant_of(Swing), **{"Q": Q, "R": [1e-2, 2e-2], "P0": P0, "X0": [0.6, -0.4]} | settings)


def riccati(t_end, x, P, u):
    """x' = f and P' = F P + P F' + Q, by SciPy."""

    def slope(_, z):
        F, P = swing_jacobian(z[:2]), z[2:].reshape(2, 2)
        return [*swing_slope(z[:2], u), *(F @ P + P @ F.T + Q).ravel()]

    z = solve_ivp(slope, (0, t_end), [*x, *P.ravel()], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    return z[:2], z[2:].reshape(2, 2)


def test_state_and_covariance_converge_to_the_riccati_equation_of_scipy():
    """With the orders 4 and 2 of the step."""
    x, P = riccati(0.8, [0.6, -0.4], P0, 0.7)
    errors = []
    for steps in (8, 16, 32):
        observer = swing()
        memory = observer.start()
        for _ in range(steps):
            follow(observer, memory, 0.7, 0.8 / steps)
        errors.append([np.abs(memory[:2] - x).max(), np.abs(observer.covariance(memory) - P).max()])
    orders = np.log2(np.array(errors)[:-1] / np.array(errors)[1:])
    assert np.allclose(orders[-1], [4, 2], atol=0.2) and errors[-1][0] < 1e-6 and errors[-1][1] < 1e-3


def discretised(h):
    """Phi and the covariance of the noise in a step, exact [Van Loan, IEEE TAC 23 (1978) 395]."""
    blocks = expm(h * np.block([[-SPRING_A, Q], [np.zeros((2, 2)), SPRING_A.T]]))
    Phi = blocks[2:, 2:].T
    return Phi, Phi @ blocks[:2, 2:]


def kalman(h, samples, inputs, R):
    """The exact filter of the spring, by matrices: the states and covariances after each sample."""
    Phi, noise = discretised(h)
    G = np.linalg.solve(SPRING_A, (Phi - np.eye(2)) @ SPRING_B)[:, 0]
    x, P, results = np.array([0.6, -0.4]), P0, []
    for y, u in zip(samples, inputs, strict=True):
        x, P = Phi @ x + G * u, Phi @ P @ Phi.T + noise
        K = P @ SPRING_C.T / (SPRING_C @ P @ SPRING_C.T + R)
        x, P = x + K[:, 0] * (y - x[0]), (np.eye(2) - K @ SPRING_C) @ P
        results.append([*x, *P.ravel()])
    return np.array(results)


def test_on_a_linear_plant_it_is_the_kalman_filter():
    rng = np.random.default_rng(1)
    samples, inputs = rng.standard_normal((2, 40))
    expected = kalman(0.1, samples, inputs, 0.05)
    distances = []
    for parts in (4, 8):
        observer = EKF(plant_of(Spring), Q=Q, R=0.05, X0=[0.6, -0.4], P0=P0)
        memory, results = observer.start(), []
        for y, u in zip(samples, inputs, strict=True):
            for _ in range(parts):
                follow(observer, memory, u, 0.1 / parts)
            correct(observer, memory, [y])
            results.append([*memory[:2], *observer.covariance(memory).ravel()])
        distances.append(np.abs(np.array(results) - expected).max())
    assert distances[1] < 1e-4 and 3.5 < distances[0] / distances[1] < 4.5


def test_covariance_settles_at_the_discrete_riccati_equation():
    observer = EKF(plant_of(Spring), Q=Q, R=0.05, P0=1.0)
    memory = observer.start()
    for _ in range(400):
        for _ in range(20):
            follow(observer, memory, 0.0, 0.005)
        before = observer.covariance(memory)
        correct(observer, memory, [0.0])
    Phi, noise = discretised(0.1)
    assert np.allclose(before, solve_discrete_are(Phi.T, SPRING_C.T, noise, np.array([[0.05]])), rtol=1e-4)


def updated(x, P, Y, R):
    """The correction by matrices, in Joseph's form: the rows of Y that are there."""
    rows = np.isfinite(Y)
    H, R = swing_output_jacobian(x)[rows], np.diag(R)[np.ix_(rows, rows)]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    keep = np.eye(2) - K @ H
    return x + K @ (Y - swing_output(x))[rows], keep @ P @ keep.T + K @ R @ K.T


@pytest.mark.parametrize("Y", [[0.4, 0.3], [np.nan, 0.3], [0.4, np.nan], [np.nan, np.nan]])
def test_a_sample_corrects_as_the_formula_with_matrices(Y):
    observer = swing()
    memory, x = observer.start(), np.array([0.6, -0.4])
    innovation, spread = correct(observer, memory, Y)
    H = swing_output_jacobian(x)
    np.testing.assert_allclose(innovation, Y - swing_output(x))
    np.testing.assert_allclose(spread, np.sqrt(np.diag(H @ P0 @ H.T) + np.array([1e-2, 2e-2])))
    X, P = updated(x, P0, np.array(Y), [1e-2, 2e-2])
    np.testing.assert_allclose(memory[:2], X, rtol=1e-12)
    np.testing.assert_allclose(observer.covariance(memory), P, rtol=1e-12, atol=1e-15)


def test_an_output_beyond_the_gate_is_not_used():
    wild, without = swing(), swing()
    far, absent = wild.start(), without.start()
    innovation, spread = correct(wild, far, [9.0, 0.3], gate=3.0)
    correct(without, absent, [np.nan, 0.3], gate=3.0)
    assert abs(innovation[0]) > 3 * spread[0] and abs(innovation[1]) < 3 * spread[1]
    np.testing.assert_array_equal(far, absent)
    correct(wild, far, [9.0, 0.3], gate=abs(innovation[0]) / spread[0] * 2)
    assert not np.array_equal(far, absent)


numbers = st.floats(-6, 6)


@given(
    scales=st.tuples(numbers, numbers, numbers), dt=st.floats(1e-3, 0.3), seed=st.integers(0, 2**32 - 1),
    offset=st.booleans(),
)  # fmt: skip
@settings(max_examples=60)
def test_the_covariance_stays_positive_and_finite(scales, dt, seed, offset):
    """However far apart noise, model and first guess are: 10^±6."""
    q, r, p = (10.0**a for a in scales)
    observer, rng = EKF(plant_of(Swing), Q=q, R=r, P0=p, offset=offset), np.random.default_rng(seed)
    memory = observer.start()
    for _ in range(30):
        follow(observer, memory, rng.standard_normal(), dt)
        before = observer.covariance(memory)
        correct(observer, memory, np.where(rng.random(2) < 0.3, np.nan, swing_output(memory[:2])))
        P = observer.covariance(memory)
        stored = memory[3:].reshape(observer.size, observer.size)
        assert np.isfinite(memory).all() and (np.diag(stored) > 0).all()
        assert np.array_equal(P, P.T) or np.abs(P - P.T).max() <= 1e-15 * np.abs(P).max()
        assert (np.diag(P) <= np.diag(before) * (1 + 1e-9)).all()  # a sample takes nothing away


def test_factors_give_the_matrix_back():
    rng = np.random.default_rng(2)
    for rank in (1, 3, 5):
        root = rng.standard_normal((5, rank))
        P = root @ root.T
        stored = factors(P)
        U = np.triu(stored, 1) + np.eye(5)
        assert np.allclose(U @ np.diag(np.diag(stored)) @ U.T, P) and np.array_equal(
            np.tril(stored, -1), np.zeros((5, 5))
        )
        assert (np.diag(stored) >= 0).all()  # variances, also of a matrix without full rank


def test_an_input_switches_within_a_step():
    observer = EKF(built_in("unicycle"), outputs=("x", "y"))
    together, apart = observer.start(), observer.start()
    follow(observer, together, [1.0, 2.0], 0.2, 0.3, after=[-1.0, 0.5], share=[0.25, 0.5])
    for U, dt, t in (([1.0, 2.0], 0.05, 0.3), ([-1.0, 2.0], 0.05, 0.35), ([-1.0, 0.5], 0.1, 0.4)):
        follow(observer, apart, U, dt, t)
    np.testing.assert_allclose(together, apart, rtol=1e-13, atol=1e-16)
    assert not np.allclose(together, observer.start())


def test_a_plant_that_depends_on_time_is_followed_by_its_clock():
    observer = EKF(driven(), X0=0.2)
    memory = observer.start()
    for k in range(10):
        follow(observer, memory, 0.5, 0.05, 0.7 + 0.05 * k)
    expected = 0.2 + 0.5 * 0.5 + (np.cos(1.4) - np.cos(2.4)) / 2
    assert abs(memory[0] - expected) < 1e-7


def test_the_state_stays_within_its_bounds():
    class Bounded(Spring):
        state_bounds = {"q": (-0.5, 0.5)}

    observer = EKF(plant_of(Bounded), R=1e-6)
    memory = observer.start()
    correct(observer, memory, [3.0])
    assert memory[0] == 0.5
    memory[1] = 5.0
    follow(observer, memory, 0.0, 0.1)
    assert memory[0] == 0.5


def test_the_offset_of_an_input_is_found():
    rng = np.random.default_rng(4)
    observer = EKF(plant_of(Spring), Q=1e-4, R=1e-4, offset=1e-3)
    assert observer.offset and observer.size == 3
    Phi, _ = discretised(0.02)
    G = np.linalg.solve(SPRING_A, (Phi - np.eye(2)) @ SPRING_B)[:, 0]
    x, memory, far = np.zeros(2), observer.start(), []
    for k in range(3000):
        u = np.sin(0.01 * k)
        x = Phi @ x + G * (u + 0.4)
        follow(observer, memory, u, 0.02)
        correct(observer, memory, [x[0] + 0.01 * rng.standard_normal()])
        far += [(memory[2] - 0.4) / np.sqrt(observer.covariance(memory)[2, 2])]
    assert abs(memory[2] - 0.4) < 0.05 and np.sqrt(np.mean(np.square(far[1000:]))) < 1.5


def test_without_the_offset_its_place_stays_zero():
    observer = EKF(plant_of(Spring))
    memory = observer.start()
    follow(observer, memory, 1.0, 0.1)
    correct(observer, memory, [0.3])
    assert memory[2] == 0 and memory.shape == (2 + 1 + 4,) and not observer.offset


def test_the_spread_is_that_of_the_errors():
    """Of 400 loops with noise drawn from Q and R: the errors' mean square by P is n, within four deviations of it."""
    rng, runs, h, R = np.random.default_rng(5), 400, 0.05, 0.02
    observer = EKF(plant_of(Spring), Q=Q, R=R, X0=[0.0, 0.0], P0=P0)
    Phi, noise = discretised(h)
    squares = []
    for _ in range(runs):
        x, memory = rng.multivariate_normal([0, 0], P0), observer.start()
        for _ in range(20):
            x = Phi @ x + rng.multivariate_normal([0, 0], noise)
            follow(observer, memory, 0.0, h)
            innovation, spread = correct(observer, memory, [x[0] + np.sqrt(R) * rng.standard_normal()])
        e = x - memory[:2]
        squares.append([e @ np.linalg.solve(observer.covariance(memory), e), (innovation[0] / spread[0]) ** 2])
    means, sizes = np.mean(squares, axis=0), np.array([2, 1])
    assert (np.abs(means - sizes) < 4 * np.sqrt(2 * sizes / runs)).all()


@pytest.mark.parametrize("kind", [EKF, npred.observers.Luenberger])
def test_some_of_the_plants_outputs_and_states_may_be_measured(kind):
    """A state, and the plant's second output: what is measured, and its derivative, are those two's."""
    observer = kind(npred.plant(Swing), outputs=("angle", "product"))
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    product = points[:, 1] * np.cos(points[:, 0]) + points[:, 0]
    np.testing.assert_allclose(observer.measured(points), np.stack([points[:, 0], product], axis=1), rtol=1e-15)
    for angle, rate in points:
        slope = [1.0 - rate * np.sin(angle), np.cos(angle)]
        _, C = observer.linearised(np.array([angle, rate]), np.zeros(1))
        np.testing.assert_allclose(C, [[1.0, 0.0], slope], rtol=1e-14)


def test_one_named_output_of_the_plant_serves_as_the_only_one_that_it_has():
    """EKF(outputs=("product",)) in a loop is the EKF of the plant that declares this output alone, number by number."""

    class Alone(Swing):
        outputs = ("product",)
        output = lambda x, t, p, M: [x.rate * M.cos(x.angle) + x.angle]

    whole, alone = npred.plant(Swing), npred.plant(Alone)
    loops = [
        npred.simulate(
            plant, npred.predictor(plant, "rk4", 11), D=0.1, D_hat=0.1, X0=[0.4, 0.0], t_end=2.0, dt=0.01,
            actuator="history", observer=EKF(plant, outputs=("product",)), measurement=npred.Measurement(noise=0.01),
        )
        for plant in (whole, alone)
    ]  # fmt: skip
    np.testing.assert_array_equal(loops[0].X, loops[1].X)


def test_all_states_are_the_outputs_of_a_plant_without_output():
    observer = EKF(built_in("chemostat"))
    assert observer.outputs == ("Z", "S") and observer.settings.shape == (2 + 4,)


class Turning:
    """Two offsets, of which the output reads one after the other."""

    states, inputs, outputs = ("a", "b"), ("U", "V"), ("y",)
    box = {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}
    f = lambda x, u, t, p, M: [u.U, u.V]
    kappa = lambda x, t, p, M: [-x.a, -x.b]
    output = lambda x, t, p, M: [M.cos(t) * x.a + M.sin(t) * x.b]


class Led(Turning):
    """The same, on its way along a reference."""

    kappa = lambda x, t, p, M: [M.cos(t) - (x.a - M.sin(t)), -x.b]
    reference = lambda t, p, M: [M.sin(t), 0.0]


class Along(Turning):
    """It turns as its output does, which reads one direction only."""

    f = lambda x, u, t, p, M: [-x.b + u.U, x.a + u.V]


@pytest.mark.parametrize("kind", [Turning, Led])
def test_a_plant_that_outputs_tell_of_only_over_time_is_observed(kind):
    """At each time by itself the observability matrix has rank 1 of 2: such plants were refused."""
    plant = plant_of(kind)
    assert np.linalg.matrix_rank(np.concatenate(EKF(plant).linearised(np.zeros(2), np.zeros(2)))) == 1
    run = npred.simulate(
        plant, npred.predictor(plant, "rk4", nx=21), D=0.3, D_hat=0.3, X0=[0.5, -0.7], t_end=60.0, dt=0.02,
        actuator="history", observer=EKF(plant, offset=True), disturbance=lambda t: [0.05, -0.1],
    )  # fmt: skip
    assert np.abs(run.X[-1] - plant.target(60.0)).max() < 0.01
    assert np.allclose(run.clock.offset, [0.05, -0.1], atol=0.01)


def test_a_plant_that_outputs_tell_of_only_at_frozen_times_is_refused():
    with pytest.raises(ConfigError, match="over time of plant Along, got an observability matrix of rank 1 of 2"):
        EKF(plant_of(Along))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: EKF(built_in("cart_pole"), outputs=("theta",)), "rank 2 of 4; measure more"),
        (lambda: EKF(built_in("pvtol"), outputs=("x",), offset=True), "leave the offset out"),
        (lambda: EKF(built_in("chemostat"), outputs=("X",)), "outputs: expected states, Z, S, got 'X'; name one"),
        (
            lambda: EKF(npred.plant(Swing), outputs=("angel",)),
            "states or outputs of the plant, angle, rate, height, product, got 'angel'; did you mean angle",
        ),
        (lambda: EKF(built_in("chemostat"), outputs=()), "outputs expected a tuple of names, got (); write"),
        (lambda: EKF(built_in("chemostat"), R=[1.0, 2.0], outputs=("S",)), "R expected one number or shape (1,)"),
        (lambda: EKF(built_in("chemostat"), R=0.0), "R expected variances above 0"),
        (lambda: EKF(built_in("chemostat"), Q=[[1.0, 2.0], [2.0, 1.0]]), "Q expected a symmetric matrix"),
        (lambda: EKF(built_in("chemostat"), P0=-1.0), "P0 expected a symmetric matrix"),
        (lambda: EKF(built_in("chemostat"), X0=[1.0, np.nan]), "X0: expected finite numbers"),
        (lambda: EKF("chemostat"), "plant: expected a Plant, got 'chemostat'"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(make, words):
    with pytest.raises(ConfigError) as caught:
        make()
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_an_observer_pickles_with_the_controller_that_has_it():
    plant = npred.plant("cart_pole")
    ekf = npred.observers.EKF(plant, outputs=("p", "theta"), offset=True)
    controller = npred.controller(
        plant, npred.predictor(plant, "rk4", 21), None, 0.01, D_hat=0.1, actuator="history", observer=ekf
    )
    for k in range(5):
        controller.step([0.1, 0.01 * k])
    copy = pickle.loads(pickle.dumps(controller))
    assert (copy.step([0.1, 0.02]) == controller.step([0.1, 0.02])).all()


def test_what_is_known_exactly_stays_finite():
    """Without noise of the model and of the first guess there is nothing to learn from a sample."""
    observer = EKF(plant_of(Spring), Q=0.0, P0=0.0, X0=[0.6, -0.4])
    memory = observer.start()
    for _ in range(10):
        follow(observer, memory, 0.5, 0.02)
        correct(observer, memory, [3.0])
    free = solve_ivp(lambda _, x: SPRING_A @ x + SPRING_B[:, 0] * 0.5, (0, 0.2), [0.6, -0.4], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(memory[:2], free.y[:, -1], atol=1e-7)
    assert not observer.covariance(memory).any()


def test_each_output_has_the_gate_of_its_own_spread():
    """One deviation of a rough output is used, and fifty of a fine one are not."""
    observer = swing(R=[1e-6, 4.0], P0=[1e-8, 1e-8])
    memory, fine = observer.start(), swing_output(np.array([0.6, -0.4]))
    innovation, spread = correct(observer, memory, fine + np.array([0.05, 2.0]), gate=3.0)
    expected, _ = updated(np.array([0.6, -0.4]), np.diag([1e-8, 1e-8]), fine + np.array([np.nan, 2.0]), [1e-6, 4.0])
    assert abs(innovation[0]) > 40 * spread[0] and abs(innovation[1]) < 2 * spread[1]
    np.testing.assert_allclose(memory[:2], expected, rtol=0, atol=1e-12)
    assert (memory[:2] != [0.6, -0.4]).any()


def test_defaults_are_shares_of_what_is_usual_of_the_plant():
    """1 % of the half range of an output, half the box; where there is no box, the size of the state at rest."""

    class Warm(Spring):
        box = {"s": (-2.0, 2.0)}
        f = lambda x, u, t, p, M: [x.s, 30.0 - x.q - x.s + u.U]
        kappa = lambda x, t, p, M: [-x.s]

    inside, without = EKF(plant_of(Spring)), EKF(plant_of(Warm))
    assert np.sqrt(inside.R[0]) == pytest.approx(0.01, rel=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(inside.P0)), [1.0, 2.0])
    np.testing.assert_allclose(np.sqrt(np.diag(without.P0)), [30.0, 2.0], rtol=1e-6)
    np.testing.assert_allclose(without.X0, [30.0, 0.0], atol=1e-6)
