"""Intervals of parameters: what the cost tells with the delay known, and what the delay leaves open."""

import numpy as np
import pytest
from recorded import recording
from test_identify import PERIOD, decay, decayed

import npred


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
