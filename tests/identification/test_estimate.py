"""How long errors stay on one side."""

import numpy as np
import pytest

from npred.identification.estimate import correlation_time


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
