"""The faults of a recording that are named before it is used: its clock, single bad samples, sensors that stick."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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


@pytest.mark.parametrize("glitch", [0, 1, 17, 199])
def test_a_bad_sample_at_an_end_of_the_log_is_found_too(glitch):
    y = noisy(200)
    y[glitch] = -127.0
    assert screening.screened(log(y), ["T"])[1] == [f"T has a bad sample at row {glitch + 2} (-127); it is left out."]


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(0, 38), st.integers(0, 15), st.booleans())
def test_of_a_fit_that_follows_a_glitch_the_glitch_is_left_out(seed, count, segment, step, after):
    """A glitch at the begin of a segment is its initial state; then the good samples behind it are missed."""
    rng = np.random.default_rng(seed)
    y = np.where(np.arange(1000) >= 25 * segment + (step if after else 0), 7.0, 0.0) + 0.05 * rng.standard_normal(1000)
    Y = y.reshape(40, 25, 1)
    r = np.clip(rng.standard_normal(Y.shape), -3, 3)
    Y[segment, :count] += 30.0
    r[segment, count : 2 * count] = -20.0  # what is missed
    assert np.argwhere(screening.outside(r, Y)).tolist() == [[segment, k, 0] for k in range(count)]


def test_an_output_without_samples_is_no_reason_to_warn():
    Y = np.stack([noisy(), np.full(400, np.nan)], axis=-1).reshape(20, 20, 2)
    r = np.where(np.isfinite(Y), 0.1, np.nan)
    r[3, 5, 0], Y[3, 5, 0] = 50.0, 90.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.argwhere(screening.outside(r, Y)).tolist() == [[3, 5, 0]]


@pytest.mark.parametrize(("count", "expected"), [(1, 1), (4, 4), (60, 0)])
def test_residuals_far_outside_are_bad_samples_where_they_are_rare(count, expected):
    r = np.random.default_rng(2).standard_normal((40, 25, 1))
    r.reshape(-1)[:: 1000 // count][:count] = 30.0
    assert screening.outside(r, r).sum() == expected


def test_where_a_model_is_wrong_samples_are_not_bad():
    """A step that comes late for the model has large residuals, and y does not come back."""
    Y = np.where(np.arange(1000) > 512, 9.0, 0.0).reshape(40, 25, 1)
    r = 0.1 * np.random.default_rng(3).standard_normal(Y.shape)
    r[20, 10:14] = 9.0
    assert not screening.outside(r, Y).any()
