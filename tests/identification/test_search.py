"""The search by values of a cost alone: its minimum, its profile, and where the cost has risen by a level."""

from types import SimpleNamespace

import numpy as np
import pytest

from npred.identification import search

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
