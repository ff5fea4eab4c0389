"""Intervals of delays and parameters: of errors that stay on one side, and of segments that disagree."""

import numpy as np
import pytest
from recorded import recording
from test_identify import PERIOD, decay, decayed

import npred
from npred.identification import search
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
    as_good = search.interval(profile.values, profile.costs - profile.costs.min(), 3.84 * delays.inflation)
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
    assert "The log hardly tells a from the delay: their errors correlate by -0.97." in found.sentences
