"""A recording as rows: their order, what is missing, and the pieces in which the delayed input is constant."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from npred.base.errors import ConfigError
from npred.identification.log import Log, Segments
from npred.identification.recordings import TimeSeries

NAN = np.nan


def series(t, values) -> TimeSeries:
    return TimeSeries(np.array(t, dtype=float), np.array(values, dtype=float), np.arange(len(t)) + 1)


def log_of(t, U, Y) -> Log:
    return Log.of(np.array(t, dtype=float), np.array(U, dtype=float)[:, None], np.array(Y, dtype=float)[:, None])


def test_rows_are_put_in_order_and_of_one_stamp_the_last_one_counts():
    log = log_of([0.0, 2.0, 1.0, 1.0, 3.0], [1, 3, 2, 4, 5], [0.1, 0.3, 0.2, 0.25, 0.4])
    assert log.t.tolist() == [0.0, 1.0, 2.0, 3.0] and log.Y[:, 0].tolist() == [0.1, 0.25, 0.3, 0.4]
    assert log.U[:, 0].tolist() == [1.0, 4.0, 3.0, 5.0]


def test_a_command_is_held_until_the_next_one_and_one_that_repeats_it_is_left_out():
    log = log_of([0, 1, 2, 3], [1, NAN, 1, 2], [NAN, 5, 6, 7]).held()
    assert log.t_U.tolist() == [0.0, 3.0] and log.t.tolist() == [1.0, 2.0, 3.0]


def test_series_with_times_of_their_own_make_one_table():
    log = Log.of_series([series([0.0, 2.0], [1.0, 2.0])], [series([1.0, 3.0], [5.0, 6.0]), None])
    assert log.t.tolist() == [1.0, 3.0] and log.Y[:, 0].tolist() == [5.0, 6.0] and np.isnan(log.Y[:, 1]).all()


def test_a_log_without_samples_is_refused_in_one_line():
    with pytest.raises(ConfigError, match="got 0 samples and 3 commands"):
        log_of([0, 1, 2], [1, 2, 3], [NAN, NAN, NAN])


def test_a_clock_that_begins_anew_begins_a_recording_whose_commands_do_not_reach_the_next():
    t = np.tile(np.arange(50.0), 2)
    log = Log.of_series([series(t, np.arange(100.0))], [series(t, np.arange(100.0))])
    assert len(log.t) == 100 and (np.diff(log.t) > 0).all() and len(log.starts) == 2
    assert log.span == 49 and log.rows.tolist() == list(range(1, 101))
    assert len(log.later(10.0).t) == 80  # of each recording the first ten
    arrived = log.arrived(log.t[50:], np.array([20.0]))[:, 0]
    assert arrived.tolist() == [50.0] * 20 + list(range(50, 80))  # its first command is held before it


def test_commands_in_straight_lines_have_the_same_mean_in_each_step():
    log = log_of([0, 1, 3], [0, 4, 0], [1, 2, 3])
    lines = log.as_lines()
    t = np.linspace(0.0, 2.999, 3000)
    assert lines.arrived(t, np.zeros(1))[:, 0] == pytest.approx(np.interp(t, log.t_U, log.U[:, 0]), abs=0.51)
    assert lines.arrived(t, np.zeros(1)).mean() == pytest.approx(np.interp(t, log.t_U, log.U[:, 0]).mean(), abs=5e-3)


def test_a_gap_ends_a_segment():
    log = log_of([0, 1, 2, 3, 50, 51, 52], range(7), range(7))
    segments = Segments.of(log, 10, 5.0)
    assert [row[mask].tolist() for row, mask in zip(segments.t, segments.mask, strict=True)] == [
        [0, 1, 2, 3],
        [50, 51, 52],
    ]


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.floats(0.01, 1.0), min_size=6, max_size=30), st.lists(st.floats(0.01, 1.5), min_size=3, max_size=20),
    st.floats(0.0, 2.0), st.floats(0.0, 2.0), st.integers(2, 6),
)  # fmt: skip
def test_pieces_add_up_to_the_integral_of_the_delayed_input(gaps, holds, first, second, rows):
    t_U, t = np.cumsum([0.0, *holds]), 2.0 + np.cumsum(gaps)
    U = np.stack([np.sin(3 * t_U + 1), np.cos(5 * t_U)], axis=1)
    table_t = np.append(t_U, t)
    order = np.argsort(table_t, kind="stable")
    blank = np.full((len(t), 2), NAN), np.full((len(t_U), 1), NAN)
    U_rows, Y_rows = np.concatenate([U, blank[0]])[order], np.concatenate([blank[1], t[:, None]])[order]
    log = Log.of(table_t[order], U_rows, Y_rows)
    segments = Segments.of(log, rows, 10.0)
    pieces = segments.pieces([first, second])
    for s in range(len(segments)):
        sums = np.concatenate([np.zeros((1, 2)), np.cumsum(pieces.held[..., s] * pieces.spans[:, None, s], axis=0)])
        times = segments.t[s][segments.mask[s]]
        for k, time in enumerate(times):
            expected = [_integral(log.t_U + d, log.U[:, j], times[0], time) for j, d in enumerate((first, second))]
            assert np.allclose(sums[pieces.rows[s, k]], expected, atol=1e-9)


def _integral(switches: np.ndarray, values: np.ndarray, start: float, end: float) -> float:
    """∫ of a held signal, whose first value holds before its first switch too."""
    ends = np.append(switches[1:], np.inf)
    begins = np.append(-np.inf, switches[1:])
    return float((values * np.clip(np.minimum(ends, end) - np.maximum(begins, start), 0.0, None)).sum())
