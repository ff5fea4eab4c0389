"""A lag in place of a delay, or behind one; and errors on what a model has not seen."""

from dataclasses import replace

import numpy as np
from recorded import recording, steps
from test_identify import PERIOD, decay, decayed

import npred
from npred.identification.alternatives import FittedModel, prediction_error


def test_a_lag_behind_the_delay_is_found_and_the_interval_has_the_shorter_delay():
    """The valve of 0.2 s behind a delay of 0.4 s looks like a delay of 0.6 s to a model that has none."""
    f = lambda x, u: np.array([-0.5 * x[0] + x[1], (u[0] - x[1]) / 0.2])
    table = recording(f, [0.0, 0.0], steps(400, 1, 15, 1), [0.4], PERIOD, 0.01, 1, outputs=1)
    found = npred.identify(decay(), *table, longest=1.5)
    assert "behind it fits clearly better" in str(found)
    assert found.interval[0, 0] <= 0.45 and found.interval[0, 1] >= 0.5


def test_an_error_on_held_back_samples_is_of_a_model_that_has_not_seen_them():
    """Only the first third of a segment gives its initial state: a shift of the rest is an error in full."""
    delays = npred.identify(decay(), *decayed(0.3, noise=0.001), longest=1.0).details["estimate"]
    segments, candidate = delays.problem.segments, FittedModel(delays.problem, delays.fit)
    third = max(2, segments.t.shape[1] // 3)
    shifted = segments.Y.copy()
    shifted[:, third:] += 0.7
    assert prediction_error(candidate, segments)[0] < 0.01
    assert abs(prediction_error(candidate, replace(segments, Y=shifted))[0] - 0.7) < 0.01
