"""The share of known loops outside known data."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from known_loops import known_loops

from npred import plants
from npred.lab.config.results import PredictorId
from npred.lab.stages.evaluate import behaviour


@pytest.mark.parametrize(
    ("value", "outside"), [(89.95, 1.0), (89.995, 0.0), (95.0, 0.0), (100.005, 0.0), (100.05, 1.0), (np.nan, 0.0)]
)
def test_outside_is_a_thousandth_of_the_range_beyond_it_on_either_side(value, outside):
    """Of a range from 90 to 100 that is 0.01, however far it is from 0; loops that diverged do not count."""
    data = SimpleNamespace(X=np.array([[90.0], [100.0]]), u=np.zeros((2, 1, 1)), D_hat=np.array([0.0, 1.0]))
    loops = known_loops([0, 0], [95.0, 95.0])
    X = np.concatenate([loops.X[:1], np.full_like(loops.X[:1], value)])
    found = behaviour.coverage(plants.resolve("scalar"), data, {PredictorId("fno"): replace(loops, X=X)})
    assert found["X"].data == (90.0, 100.0) and found["X"].outside[PredictorId("fno")] == outside / 2
