"""Sensors: samples are exact where the model is, random as asked for; each error is its formula."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

import npred
from npred.base.errors import ConfigError
from npred.loop.measurement import Measurement
from npred.plants import Plant

PLANT = npred.plant("activator_repressor")
RK4 = npred.predictor(PLANT, "rk4", nx=51)
START = {"D": 1.0, "D_hat": 1.0, "X0": [0.03, 30.0], "t_end": 20.0, "dt": 0.01}


def loop(measurement=None, **changes):
    return npred.simulate(PLANT, RK4, measurement=measurement, **(START | changes))


@pytest.mark.parametrize(
    "settings",
    [{"period": 0.05}, {"period": 0.2, "jitter": 0.9}, {"delay": 0.3}, {"delay": 0.1, "period": 0.15, "drop": 0.5}],
)
def test_a_perfect_model_fills_every_gap_exactly(settings):
    """Between samples the state is predicted with the commands that have arrived since: no error is left."""
    assert np.abs(loop(Measurement(**settings)).X - loop().X).max() < 1e-12


class Driven:
    """Two lags, each driven by the time and by an input of its own."""

    states, inputs = ("a", "b"), ("u", "v")
    f = lambda x, u, t, p, M: [u.u - x.a + M.cos(5 * t), u.v - x.b + M.sin(3 * t)]
    kappa = lambda x, t, p, M: [M.sin(2 * t) - x.a, -2 * x.b]


@pytest.mark.parametrize("delays", [(1.0, 1.0), (0.37, 1.0)])
def test_so_does_one_that_knows_the_time_and_a_delay_for_each_input(delays):
    plant = Plant("driven", type("Driven", (Driven,), {"delays": delays}))
    sparse, start = Measurement(delay=0.1, period=0.15, drop=0.5), {"X0": [0.5, -0.3], "t_end": 4.0, "dt": 0.01}
    runs = [
        npred.simulate(plant, npred.predictor(plant, "rk4", nx=21), D=0.537, D_hat=0.537, measurement=seen, **start)
        for seen in (sparse, None)
    ]
    assert np.abs(runs[0].X - runs[1].X).max() < 1e-12


def test_between_samples_the_controller_believes_its_model():
    """X' = X / 2 + U without a delay, U = -3 X_hat / 2, of a plant X' = X + U: both in closed form."""
    model, truth = npred.plant("scalar", a=0.5, c=1.0), npred.plant("scalar", a=1.0, c=1.0)
    run = npred.simulate(
        model, npred.predictor(model, "rk4", nx=5), D=0.0, D_hat=0.0, X0=[1.0], t_end=2.0, dt=0.01,
        measurement=Measurement(period=0.2), truth=truth,
    )  # fmt: skip
    X = X_hat = 1.0
    for k in range(200):
        X_hat = X if k % 20 == 0 else X_hat
        assert run.X[k, 0] == pytest.approx(X, rel=1e-9) and run.U[k, 0] == pytest.approx(-1.5 * X_hat, rel=1e-9)
        X, X_hat = ((x - 1.5 * X_hat / a) * np.exp(a * 0.01) + 1.5 * X_hat / a for x, a in ((X, 1.0), (X_hat, 0.5)))


def test_the_defaults_are_perfect():
    assert np.array_equal(loop(Measurement(seed=3)).X, loop().X)


def seen(**settings):
    """X_hat at each step of many loops, by an observer that only looks."""
    samples = []

    def look(X_hat, Y, U, t):
        samples.append(Y.copy())
        return np.where(np.isnan(Y), X_hat, Y)

    changes = {"X0": np.tile(START["X0"], (40, 1)), "t_end": 5.0}
    X = loop(Measurement(observer=look, **settings), **changes).X
    return np.stack(samples, axis=1), X


def test_noise_is_relative_normal_and_independent_in_time_and_state():
    Y, X = seen(relative_noise=0.02, seed=1)
    errors = (Y / X - 1) / 0.02
    assert abs(errors.mean()) < 0.02 and errors.std() == pytest.approx(1, abs=0.02)
    assert np.mean(np.abs(errors) > 1.96) == pytest.approx(0.05, abs=0.005)
    assert abs(np.corrcoef(errors[..., 0].ravel(), errors[..., 1].ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(errors[:, 1:, 0].ravel(), errors[:, :-1, 0].ravel())[0, 1]) < 0.02


def test_samples_come_at_their_period_late_and_some_never():
    Y, X = seen(period=0.1, delay=0.05, drop=0.25, seed=2)
    steps = np.arange(Y.shape[1])
    arrived = ~np.isnan(Y[..., 0])
    assert arrived[:, 0].all() and not arrived[:, (steps > 0) & (steps % 10 != 5)].any()
    assert arrived[:, steps % 10 == 5].mean() == pytest.approx(0.75, abs=0.04)
    loops, late = np.nonzero(arrived[:, 15:])
    np.testing.assert_array_equal(Y[loops, late + 15], X[loops, late + 10])


def test_jitter_spreads_the_gaps_evenly():
    Y, _ = seen(period=0.1, jitter=0.5, seed=5)
    gaps = np.concatenate([np.diff(np.flatnonzero(~np.isnan(row[:, 0]))) for row in Y])
    assert gaps.min() == 5 and gaps.max() in (15, 16) and gaps.mean() == pytest.approx(10, abs=0.3)


def arrivals(**settings):
    """The gaps between samples that arrive, in control steps, of all loops."""
    Y, _ = seen(**settings)
    return np.concatenate([np.diff(np.flatnonzero(~np.isnan(row[:, 0]))) for row in Y])


def test_a_period_of_whole_steps_is_one_whatever_its_quotient_rounds_to():
    assert 0.07 / 0.01 > 7
    assert set(arrivals(period=0.07)) == {7}


def test_no_gap_is_shorter_than_a_control_step():
    """Gaps g of 0.1 to 3.9 steps, g < 1 counted as 1: (0.9 + (3.9² - 1) / 2) / 3.8 steps on average."""
    assert arrivals(period=0.02, jitter=0.95, seed=9).mean() == pytest.approx(2.107, abs=0.04)


def test_whether_a_sample_is_lost_says_nothing_of_the_gap_behind_it():
    """Of gaps of 5 to 15 steps, a fraction rounded either way, 0.45 are below ten; half of these end in a sample."""
    gaps = arrivals(period=0.1, jitter=0.5, drop=0.5, seed=4)
    assert np.mean(gaps < 10) == pytest.approx(0.225, abs=0.04)


def test_noise_says_nothing_of_gaps_and_drops():
    Y, X = seen(relative_noise=0.02, period=0.1, jitter=0.5, drop=0.5, seed=6)
    errors = (Y / X - 1)[..., 0] / 0.02
    assert np.nanstd(errors) == pytest.approx(1, abs=0.1)
    Y, X = seen(relative_noise=0.02, period=0.1, jitter=0.5, seed=6)
    sizes, gaps = [], []
    for row in (Y / X - 1)[..., 0]:
        arrived = np.flatnonzero(~np.isnan(row))
        sizes, gaps = [*sizes, *np.abs(row[arrived[:-1]])], [*gaps, *np.diff(arrived)]
    assert abs(np.corrcoef(sizes, gaps)[0, 1]) < 0.1


def test_the_numbers_depend_on_the_seed_and_the_loop_alone():
    """The batch, its chunks and the order of the loops change nothing."""
    noisy = Measurement(relative_noise=0.01, period=0.05, jitter=0.3, drop=0.1, seed=7)
    many = loop(noisy, X0=np.tile(START["X0"], (70, 1)), t_end=2.0)
    few = loop(noisy, X0=np.tile(START["X0"], (3, 1)), t_end=2.0)
    assert np.array_equal(many.X[:3], few.X)
    assert not np.array_equal(few.X[0], few.X[1])
    assert not np.array_equal(loop(Measurement(relative_noise=0.01, seed=8), t_end=2.0).X, loop(noisy, t_end=2.0).X)


def test_a_network_or_any_predictor_in_python_sees_the_same_samples():
    class InPython(npred.Predictor):
        def predict(self, X, u, D_hat, t):
            return RK4.predict(X, u, D_hat, t)

    noisy = Measurement(relative_noise=0.01, period=0.05, delay=0.02, seed=3)
    run = npred.simulate(PLANT, InPython(PLANT, 51), measurement=noisy, **(START | {"t_end": 2.0}))
    np.testing.assert_allclose(run.X, loop(noisy, t_end=2.0).X, rtol=1e-12, atol=1e-14)


def test_an_observer_gets_what_it_needs_and_replaces_the_model():
    """A Luenberger observer of x2 from x1 alone, with the model's own f: it follows the state that is not measured."""
    dt = START["dt"]

    def observe(X_hat, Y, U, t):
        if t == 0:
            return np.array([[0.03, 20.0]])
        forward = X_hat + dt * PLANT.f(X_hat, U, t)
        return forward + dt * (Y[:, :1] - forward[:, :1]) * np.array([5.0, 0.0])

    run = loop(Measurement(observer=observe), X0=[START["X0"]], t_end=60.0)
    assert np.abs(run.X[0, -100:] - PLANT.equilibrium).max() < 1e-2


def test_a_measurement_or_an_observer_that_is_wrong_is_refused():
    for wrong, words in (
        ({"relative_noise": -0.1}, "expected relative_noise of at least 0, got -0.1"),
        ({"period": 0.0}, "expected a period above 0, got 0.0; None is every step"),
        ({"drop": 1.0}, "expected drop from 0 up to 1, not included, got 1"),
        ({"seed": 0.5}, "expected a whole number of 64 bits as seed, got 0.5"),
        ({"first": 2**63}, "expected a whole number of 64 bits as first"),
        ({"jitter": 0.1}, "expected a period that jitter spreads, got none; give period"),
        ({"observer": 3}, "expected a function of X_hat, Y, U and t as observer, got 3"),
    ):
        with pytest.raises(ConfigError, match=words):
            Measurement(**wrong)
    with pytest.raises(ConfigError, match=r"measurement: expected a period of at least dt = 0.01, got 0.005; raise it"):
        loop(Measurement(period=0.005))
    with pytest.raises(ConfigError, match=r"observer: expected to return \(1, 2\), a row per loop, got \(2,\)"):
        loop(Measurement(observer=lambda X_hat, Y, U, t: X_hat[0]), X0=[START["X0"]])
    with pytest.raises(ConfigError, match=r"measurement: expected an npred.Measurement, got 0.01"):
        loop(0.01)


PLANTS = {1: npred.plant("scalar"), 2: npred.plant("van_der_pol"), 3: npred.plant("unicycle")}
DT, STEPS = 0.01, 10
ERRORS = ("noise", "relative_noise", "bias", "resolution")


def samples(measurement, X0, steps=STEPS):
    """The samples Y (B, steps + 1, n) and the states X of open loops."""
    taken = []

    def look(X_hat, Y, U, t):
        taken.append(Y.copy())
        return Y

    X0 = np.atleast_2d(X0)
    run = npred.simulate(
        PLANTS[X0.shape[1]], None, D=0.1, D_hat=0.1, X0=X0, t_end=steps * DT, dt=DT, u0=np.zeros(PLANTS[X0.shape[1]].m),
        measurement=replace(measurement, observer=look),
    )  # fmt: skip
    return np.stack(taken, axis=1), run.X


def mixed(z):
    """The output function of SplitMix64, on Python's integers."""
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 % 2**64
    z = (z ^ z >> 27) * 0x94D049BB133111EB % 2**64
    return z ^ z >> 31


def drawn(*parts):
    """A standard normal number by Box and Muller: seed, loop, sample, state and purpose."""
    share = []
    for sign in (1, -1):
        z = 0x9E3779B97F4A7C15
        for part in (*parts[:-1], sign * parts[-1]):
            z = mixed(((z ^ part % 2**64) + 0x9E3779B97F4A7C15) % 2**64)
        share.append(((z >> 11) + 0.5) / 2**53)
    return np.sqrt(-2 * np.log(share[0])) * np.cos(2 * np.pi * share[1])


def draws(measurement, shape, purpose):
    loop, sample, state = np.indices(shape)
    parts = np.nditer([loop + measurement.first, sample, state])
    return np.reshape([drawn(measurement.seed, *map(int, place), purpose) for place in parts], shape)


def unrounded(measurement, X):
    """X (1 + relative ξ) + absolute η + bias."""
    absolute, relative, bias = (np.array(getattr(measurement, name)) for name in ERRORS[:3])
    xi, eta = (draws(measurement, X.shape, purpose) for purpose in (1, 4))
    return X * (1 + relative * xi) + absolute * eta + bias


def rounded(value, step):
    """The nearest multiple, half to even, in exact fractions."""
    return float(round(Fraction(value) / Fraction(step)) * Fraction(step)) if step else value


def numbers(n, low, high):
    """A number, or one per state, 0 among them."""
    one = st.one_of(st.just(0.0), st.floats(low, high))
    return st.one_of(one, st.lists(one, min_size=n, max_size=n), st.lists(one, min_size=n, max_size=n).map(np.array))


@st.composite
def sensors(draw, *names):
    """Sensors of 1 to 3 states, and starts of one to three loops."""
    n = draw(st.integers(1, 3))
    low = {"bias": -2.0, "resolution": 1e-3}
    errors = {name: draw(numbers(n, low.get(name, 1e-6), 2.0)) for name in names}
    seed, first = draw(st.integers(-(2**63), 2**63 - 1)), draw(st.integers(0, 10**6))
    X0 = draw(st.lists(st.lists(st.sampled_from([0.0, -0.7, 1.3]), min_size=n, max_size=n), min_size=1, max_size=3))
    return Measurement(**errors, seed=seed, first=first), X0


@settings(max_examples=40, deadline=None)
@given(sensors("relative_noise", "noise", "bias"))
def test_each_sample_is_the_one_of_the_formula(case):
    Y, X = samples(*case)
    np.testing.assert_allclose(Y, unrounded(case[0], X), rtol=1e-13, atol=1e-13)


@settings(max_examples=40, deadline=None)
@given(sensors("bias", "resolution"))
def test_a_bias_and_a_resolution_are_exact(case):
    measurement, X0 = case
    Y, X = samples(measurement, X0)
    steps = np.broadcast_to(measurement.resolution, X.shape)
    biased = X + np.array(measurement.bias)
    expected = [rounded(value, step) for value, step in zip(biased.flat, steps.flat, strict=True)]
    np.testing.assert_array_equal(Y.ravel(), expected)


@settings(max_examples=40, deadline=None)
@given(sensors(*ERRORS))
def test_what_is_rounded_is_the_noisy_sample(case):
    measurement, X0 = case
    Y, X = samples(measurement, X0)
    steps, value = np.broadcast_to(measurement.resolution, X.shape), unrounded(measurement, X)
    assert (np.abs(Y - value) <= steps / 2 + 1e-12).all()
    for sample, step in zip(Y.flat, steps.flat, strict=True):
        assert sample == rounded(sample, step)


def test_a_half_is_rounded_to_the_even_multiple():
    X0 = np.array([0.25, 0.75, -0.25, -0.75, 1.25])
    Y, _ = samples(Measurement(resolution=0.5), X0[:, None])
    assert Y[:, 0, 0].tolist() == [0.0, 1.0, 0.0, -1.0, 1.0]
    Y, _ = samples(Measurement(resolution=3.0), np.array([[1.5], [4.5], [7.5], [10.5], [13.5]]))
    assert Y[:, 0, 0].tolist() == [0.0, 6.0, 6.0, 12.0, 12.0]


def test_what_only_a_rounded_quotient_takes_for_a_half_is_none():
    """0.1 in binary is above a tenth, so 0.75 is nearer to 7 times it than to 8 times, though 0.75 / 0.1 is 7.5."""
    Y, _ = samples(Measurement(resolution=0.1), [[0.75]])
    assert 0.75 / 0.1 == 7.5 and Y[0, 0, 0] == 7 * 0.1


def test_a_state_at_zero_has_normal_noise_of_its_own_size():
    Y, X = samples(Measurement(relative_noise=0.5, noise=[0.1, 3.0], seed=3), np.zeros((40, 2)), steps=250)
    assert not X.any()
    for errors in (Y[..., 0] / 0.1, Y[..., 1] / 3.0):
        assert scipy.stats.kstest(errors.ravel(), "norm").pvalue > 1e-3
        assert abs(np.corrcoef(errors[:, 1:].ravel(), errors[:, :-1].ravel())[0, 1]) < 0.03
    assert abs(np.corrcoef(Y[..., 0].ravel(), Y[..., 1].ravel())[0, 1]) < 0.03


def test_relative_and_absolute_noise_are_independent():
    """The variance of a sum is the sum of variances, (0.03 X)² + 0.04²; so are both parts' numbers."""
    X0 = np.full((40, 2), 0.8)
    Y, X = samples(Measurement(relative_noise=0.03, noise=0.04, seed=5), X0, steps=250)
    assert np.std((Y - X) / np.hypot(0.03 * X, 0.04)) == pytest.approx(1.0, abs=0.02)
    relative, absolute = (
        (np.subtract(*samples(Measurement(**{name: 0.05}, seed=5), X0, steps=250))).ravel()
        for name in ("relative_noise", "noise")
    )
    assert abs(np.corrcoef(relative, absolute)[0, 1]) < 0.03


def closed(measurement, **changes):
    plant = PLANTS[2]
    start = {"X0": [[0.5, -0.2], [0.1, 0.3]], "D": 0.5, "D_hat": 0.5, "dt": 0.01, "t_end": 3.0} | changes
    return npred.simulate(plant, npred.predictor(plant, "rk4", nx=51), measurement=measurement, **start)


def test_a_number_is_the_same_as_it_for_each_state():
    one = Measurement(relative_noise=0.02, noise=0.01, bias=0.1, resolution=0.05, seed=2)
    each = Measurement(np.full(2, 0.01), relative_noise=[0.02] * 2, bias=(0.1, 0.1), resolution=[0.05, 0.05], seed=2)
    np.testing.assert_array_equal(closed(one).X, closed(each).X)
    assert not np.array_equal(closed(one).X, closed(Measurement(relative_noise=0.02, seed=2)).X)
    assert hash(each) and each == Measurement(
        [0.01] * 2, relative_noise=(0.02, 0.02), bias=[0.1] * 2, resolution=[0.05] * 2, seed=2
    )


def test_sensors_without_errors_are_perfect():
    zero = Measurement(relative_noise=[0.0, 0.0], noise=0, bias=[0, 0], resolution=0.0)
    assert zero.perfect and np.array_equal(closed(zero).X, closed(None).X)
    for name in ERRORS:
        assert not Measurement(**{name: [0.0, 0.1]}).perfect


def test_the_loop_rests_where_a_bias_puts_it():
    """Near 0 the plant is X' = A X + (0, U): at rest x1 = U = -K (X + e^(A D) (b, 0)), in closed form."""
    b, D = 1e-5, 0.5
    E = scipy.linalg.expm(D * np.array([[0.0, 1.0], [-1.0, 1.0]]))
    expected = -(6 * E[0, 0] + 4 * E[1, 0]) * b / 7
    X = closed(Measurement(bias=[b, 0.0]), t_end=40.0).X[:, -1]
    np.testing.assert_allclose(X[:, 0], expected, rtol=1e-5)
    assert np.abs(X[:, 1]).max() < 1e-10


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        ({"relative_noise": [0.1, -0.1]}, r"expected relative_noise of at least 0, got -0.1 at \[1\]; give 0 or more"),
        ({"noise": -1}, "measurement: expected noise of at least 0, got -1; give 0 or more"),
        ({"noise": math.nan}, "measurement: expected noise of at least 0, got nan; give 0 or more"),
        ({"resolution": [math.inf]}, r"measurement: expected resolution of at least 0, got inf at \[0\]; give 0 or"),
        ({"bias": [0.0, math.nan]}, r"measurement: bias: expected finite numbers, got nan at \[1\]; replace it"),
        ({"bias": np.ma.masked_array([1.0, 2.0], [0, 1])}, "measurement: bias: expected one real number, or one per"
         " state, got a masked array; convert it"),
        ({"relative_noise": "0.1"}, "relative_noise: expected one real number, or one per state, got '0.1'"),
        ({"relative_noise": [[0.1]]}, r"measurement: relative_noise: .* got an array of shape \(1, 1\); give a list"),
        ({"resolution": [[1.0], [1.0, 2.0]]}, "measurement: resolution: expected one real number, or one per state"),
    ],
)  # fmt: skip
def test_errors_that_make_no_sense_are_refused(errors, words):
    with pytest.raises(ConfigError, match=words) as error:
        Measurement(**errors)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("count", [0, 1, 3])
@pytest.mark.parametrize("name", ERRORS)
def test_a_list_has_a_number_for_each_state(name, count):
    with pytest.raises(
        ConfigError, match=f"expected {name} as one number or 2, one per state of plant van_der_pol, got {count}"
    ):
        closed(Measurement(**{name: [0.1] * count}))
