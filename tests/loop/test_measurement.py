"""What the controller sees of the plant: exact where the model is, random as asked for, the same in any batch."""

import numpy as np
import pytest

import npred
from npred.base.errors import ConfigError
from npred.loop.measurement import Measurement
from npred.plants import Plant

PLANT = npred.plant("activator_repressor")
RK4 = npred.predictor("rk4", PLANT, nx=51)
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
        npred.simulate(plant, npred.predictor("rk4", plant, nx=21), D=0.537, D_hat=0.537, measurement=seen, **start)
        for seen in (sparse, None)
    ]
    assert np.abs(runs[0].X - runs[1].X).max() < 1e-12


def test_between_samples_the_controller_believes_its_model():
    """X' = X / 2 + U without a delay, U = -3 X_hat / 2, of a plant X' = X + U: both in closed form."""
    model, truth = npred.plant("scalar", a=0.5, c=1.0), npred.plant("scalar", a=1.0, c=1.0)
    run = npred.simulate(
        model, npred.predictor("rk4", model, nx=5), D=0.0, D_hat=0.0, X0=[1.0], t_end=2.0, dt=0.01,
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
    Y, X = seen(noise=0.02, seed=1)
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
    Y, X = seen(noise=0.02, period=0.1, jitter=0.5, drop=0.5, seed=6)
    errors = (Y / X - 1)[..., 0] / 0.02
    assert np.nanstd(errors) == pytest.approx(1, abs=0.1)
    Y, X = seen(noise=0.02, period=0.1, jitter=0.5, seed=6)
    sizes, gaps = [], []
    for row in (Y / X - 1)[..., 0]:
        arrived = np.flatnonzero(~np.isnan(row))
        sizes, gaps = [*sizes, *np.abs(row[arrived[:-1]])], [*gaps, *np.diff(arrived)]
    assert abs(np.corrcoef(sizes, gaps)[0, 1]) < 0.1


def test_the_numbers_depend_on_the_seed_and_the_loop_alone():
    """The batch, its chunks and the order of the loops change nothing."""
    noisy = Measurement(noise=0.01, period=0.05, jitter=0.3, drop=0.1, seed=7)
    many = loop(noisy, X0=np.tile(START["X0"], (70, 1)), t_end=2.0)
    few = loop(noisy, X0=np.tile(START["X0"], (3, 1)), t_end=2.0)
    assert np.array_equal(many.X[:3], few.X)
    assert not np.array_equal(few.X[0], few.X[1])
    assert not np.array_equal(loop(Measurement(noise=0.01, seed=8), t_end=2.0).X, loop(noisy, t_end=2.0).X)


def test_a_network_or_any_predictor_in_python_sees_the_same_samples():
    class InPython(npred.Predictor):
        def predict(self, X, u, D_hat, t):
            return RK4.predict(X, u, D_hat, t)

    noisy = Measurement(noise=0.01, period=0.05, delay=0.02, seed=3)
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
    for settings, words in (
        ({"noise": -0.1}, "expected noise of at least 0, got -0.1"),
        ({"period": 0.0}, "expected a period above 0, got 0.0; None is every step"),
        ({"drop": 1.0}, "expected drop from 0 up to 1, not included, got 1"),
        ({"seed": 0.5}, "expected a whole number of 64 bits as seed, got 0.5"),
        ({"first": 2**63}, "expected a whole number of 64 bits as first"),
        ({"jitter": 0.1}, "expected a period that jitter spreads, got none; give period"),
        ({"observer": 3}, "expected a function of X_hat, Y, U and t as observer, got 3"),
    ):
        with pytest.raises(ConfigError, match=words):
            Measurement(**settings)
    with pytest.raises(ConfigError, match=r"measurement: expected a period of at least dt = 0.01, got 0.005; raise it"):
        loop(Measurement(period=0.005))
    with pytest.raises(ConfigError, match=r"observer: expected to return \(1, 2\), a row per loop, got \(2,\)"):
        loop(Measurement(observer=lambda X_hat, Y, U, t: X_hat[0]), X0=[START["X0"]])
    with pytest.raises(ConfigError, match=r"measurement: expected an npred.Measurement, got 0.01"):
        loop(0.01)
