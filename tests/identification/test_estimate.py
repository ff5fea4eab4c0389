"""The search, the intervals it gives, and the delay or lag between which the data decide."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from recorded import recording, steps
from test_identify import PERIOD, decay, decayed

import npred
from npred.identification import search
from npred.identification.alternatives import FittedModel, prediction_error
from npred.identification.estimate import correlation_time, drawn


@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
def test_the_correlation_time_is_that_of_an_autoregression(rho):
    """(1 + ρ) / (1 - ρ), of segments of 60 samples some of which are missing."""
    rng = np.random.default_rng(1)
    r = np.empty((400, 60, 1))
    r[:, 0, 0] = rng.standard_normal(400)
    for k in range(1, 60):
        r[:, k, 0] = rho * r[:, k - 1, 0] + np.sqrt(1 - rho**2) * rng.standard_normal(400)
    r[rng.random(r.shape) < 0.1] = np.nan
    assert correlation_time(r) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)


def slow_noise(t, X):
    """Errors of the sensor that stay on one side for a second."""
    rng, e = np.random.default_rng(0), np.zeros_like(X)
    for k in range(1, len(X)):
        e[k] = 0.97 * e[k - 1] + 0.01 * rng.standard_normal()
    return X + e


def jumps(t, X):
    """The delay is 0.4 s from the middle on."""
    return np.where((t < 15)[:, None], X, decayed(0.4, 0.005, 0)[2])


@pytest.mark.parametrize(("D", "noise", "real"), [(0.3, 0.0, slow_noise), (0.25, 0.005, jumps)])
def test_an_interval_has_all_that_costs_as_much_as_correlated_errors_do_and_what_drawn_segments_say(D, noise, real):
    t, U, X = decayed(D, noise)
    found = npred.identify(decay(), t, U, real(t, X), longest=1.0)
    delays, (low, high) = found.details["estimate"], found.interval[0]
    profile = delays.profiles[0]
    as_good = search.interval(profile.values, profile.costs - profile.costs.min(), delays.levels[0])
    assert delays.levels[0] >= 3.84 * delays.inflation
    draws = np.quantile(drawn(profile, np.random.default_rng(5))[0], (0.05, 0.95))
    assert delays.inflation > 2
    assert low <= min(as_good[0], draws[0]) and max(as_good[1], draws[1]) <= high


def test_an_interval_is_no_narrower_than_the_curvature_of_the_cost_says():
    """With the delay known, 1.96 deviations of the normal equations to either side."""
    table = decayed(0.337, 0.03, 0, a=-0.6, b=1.1, count=250)
    found = npred.identify(decay(), *table, free=["a", "b"], longest=1.0)
    fit = found.details["estimate"].fit
    deviations = np.sqrt(np.diag(np.linalg.inv(fit.H.sum(axis=0))))
    for name, deviation in zip(("a", "b"), deviations, strict=True):
        value, (low, high) = found.parameters[name], found.parameter_intervals[name]
        assert low <= value - 1.959 * deviation and value + 1.959 * deviation <= high
        assert high - low < 4 * 1.96 * deviation


@pytest.mark.parametrize("seed", [0, 1])
def test_a_parameter_that_looks_like_a_delay_has_an_interval_for_both(seed):
    """Of a slow sine: a later one is as good with another time constant."""
    wave = 0.8 * np.sin(2 * np.pi * np.arange(400) / 80)[:, None]  # a period of 4 s
    table = recording(lambda x, u: -0.5 * x + u, [0.0], wave, [0.3], PERIOD, 0.05, seed)
    found = npred.identify(decay(), *table, longest=1.0, free=["a"])
    low, high = found.parameter_intervals["a"]
    assert low <= -0.5 <= high and found.interval[0, 0] <= 0.3 <= found.interval[0, 1]
    assert "The log hardly tells a from the delay: their errors correlate with -0.9" in str(found)


LOW, HIGH = np.zeros(2), np.full(2, 3.0)
BEST, CURVES = np.array([0.7, 1.9]), np.array([[400.0, 30.0], [30.0, 25.0]])


def at(z, _):
    """A parabola over two delays, which depend on each other."""
    return SimpleNamespace(cost=float(9 + (z - BEST) @ CURVES @ (z - BEST)))


def test_a_descent_ends_at_the_least_cost_and_knows_its_widths():
    z, fit, widths = search.descend(at, at(np.ones(2), None), np.ones(2), LOW, HIGH, 0.2, 1e-4)
    np.testing.assert_allclose(z, BEST, atol=2e-3)
    np.testing.assert_allclose(widths, 1 / np.sqrt(np.diag(CURVES)), rtol=0.3)
    assert fit.cost < 9.001


@pytest.mark.parametrize("level", [3.84, 38.4])
@pytest.mark.parametrize("j", [0, 1])
def test_an_interval_ends_where_the_profile_has_risen_by_the_level(j, level):
    """The other delay is at its best along it; also of errors that stay on one side for ten samples."""
    widths = 1 / np.sqrt(np.diag(CURVES))
    profile = search.profile(at, at(BEST, None), BEST, j, LOW, HIGH, widths)
    half = np.sqrt(level * np.linalg.inv(CURVES)[j, j])
    expected = np.clip(BEST[j] + half * np.array([-1, 1]), 0, 3)
    ends = search.interval(profile.values, profile.costs - profile.costs.min(), level)
    np.testing.assert_allclose(ends, expected, atol=0.03 * half)


def test_a_lag_behind_the_delay_is_found_and_the_interval_has_the_shorter_delay():
    """The valve of 0.2 s behind a delay of 0.4 s looks like a delay of 0.6 s to a model that has none."""
    f = lambda x, u: np.array([-0.5 * x[0] + x[1], (u[0] - x[1]) / 0.2])
    table = recording(f, [0.0, 0.0], steps(400, 1, 15, 1), [0.4], PERIOD, 0.01, 1, outputs=1)
    found = npred.identify(decay(), *table, longest=1.5)
    assert "behind it fits clearly better" in str(found) and found.refused  # it predicts better, too
    assert found.interval[0, 0] <= 0.45 and found.interval[0, 1] >= 0.5


def test_an_error_on_held_back_samples_is_of_a_model_that_has_not_seen_them():
    """Only the first third of a segment gives its initial state: a shift of the rest is an error in full."""
    delays = npred.identify(decay(), *decayed(0.3, noise=0.001), longest=1.0).details["estimate"]
    segments, candidate = delays.problem.segments, FittedModel(delays.problem, delays.fit)
    third = max(2, segments.t.shape[1] // 3)
    shifted = segments.Y.copy()
    shifted[:, third:] += 0.7
    later = np.arange(len(segments)) > len(segments) // 2
    assert np.sqrt(prediction_error(candidate, segments, later).mean()) < 0.01
    assert abs(np.sqrt(prediction_error(candidate, replace(segments, Y=shifted), later).mean()) - 0.7) < 0.01


def test_constant_gains_are_the_best_rival_where_an_output_never_moves():
    t, U, X = decayed(0.3, noise=0.0)
    found = npred.identify(decay(), t, U, np.where(np.isnan(X), X, 1.0), longest=1.0)
    assert found.refused and found.held_back["static"] < 1e-9 < found.held_back["model"]
