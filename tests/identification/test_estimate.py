"""How long errors stay on one side, and intervals that know of it and of segments that disagree."""

import numpy as np
import pytest
from test_identify import decay, decayed

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
