"""The faults of a recording that are named before it is used: its clock, single bad samples, sensors that stick."""

import numpy as np
import pytest

from npred.identification import screening
from npred.identification.log import Log
from npred.identification.recordings import TimeSeries


def series(t) -> TimeSeries:
    t = np.asarray(t, dtype=float)
    return TimeSeries(t, np.sin(t), np.arange(len(t)) + 2)  # a header is the first line


def noisy(count: int = 400, seed: int = 0) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).standard_normal(count)) * 0.1


def log(y: np.ndarray) -> Log:
    t = np.arange(len(y), dtype=float)
    return Log.of(t, np.sin(t)[:, None], y[:, None], np.arange(len(y)) + 2)


STEADY = np.arange(100.0)


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (STEADY, []),
        (np.append(STEADY, STEADY), ["The clock restarts at row 102: each part is taken as a recording"]),
        (np.insert(STEADY, 40, 40.0), ["Row 43 has the stamp of the row before: the later one counts."]),
        (np.append(STEADY, 5000.0 + STEADY), ["There is no sample for 4901 min after row 101: the last command"]),
        (np.floor(STEADY / 5), ["The stamps are coarse: 81% of the rows"]),
        (np.random.default_rng(1).permutation(STEADY), []),  # rows in any order
    ],
)
def test_the_clock_is_named(t, words):
    notes = screening.of_clock([series(t)], "min")
    assert len(notes) == len(words) and all(word in note for word, note in zip(words, notes, strict=True))


def test_rows_of_a_coarse_stamp_are_spread_evenly():
    spread = screening.spaced(series(np.floor(STEADY / 5)))
    np.testing.assert_allclose(spread.t, STEADY / 5)
    assert screening.spaced(series(STEADY)).t.tolist() == STEADY.tolist()


@pytest.mark.parametrize("bad", [-127.0, 65535.0])
def test_a_sample_out_of_any_range_is_named_by_its_row_and_left_out(bad):
    y = noisy()
    y[[100, 250]] = bad
    kept, notes = screening.screened(log(y), ["T"])
    assert len(kept.t) == 398 and not np.isin(kept.Y, bad).any()
    assert notes == [f"T has 2 bad samples at rows 102, 252 ({bad:.4g}, {bad:.4g}); they are left out."]


def test_a_step_and_noise_are_no_bad_samples():
    y = noisy() + 50 * (np.arange(400) > 200)
    kept, notes = screening.screened(log(y), ["T"])
    assert notes == [] and np.array_equal(kept.Y[:, 0], y)


def test_a_sensor_that_sticks_is_named_and_one_that_rests_is_not():
    y = noisy()
    y[150:190] = y[150]
    kept, notes = screening.screened(log(y), ["T"])
    assert len(kept.t) == 361 and f"T stays at {y[150]:.4g} from row 152 to row 191" in notes[0]
    rest = np.repeat(noisy(20), 20)  # every value stays: the sensor is coarse
    assert screening.screened(log(rest), ["T"])[1] == []


@pytest.mark.parametrize(("count", "expected"), [(1, 1), (4, 4), (60, 0)])
def test_residuals_far_outside_are_bad_samples_where_they_are_rare(count, expected):
    r = np.random.default_rng(2).standard_normal((40, 25, 1))
    r.reshape(-1)[:: 1000 // count][:count] = 30.0
    assert screening.outside(r, 0 * r).sum() == expected
