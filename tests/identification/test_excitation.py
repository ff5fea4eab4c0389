"""What the commands of a log cannot tell, by how they move."""

import numpy as np
import pytest
from scipy.signal import max_len_seq

from npred.identification import excitation
from npred.identification.log import Log, Segments

T = np.arange(1200) * 0.05
RNG = np.random.default_rng(0)
LEVELS = np.repeat(RNG.uniform(-1, 1, 120), 10)


def log(U: np.ndarray, y: np.ndarray | None = None) -> Log:
    U = U.reshape(len(T), -1)
    return Log.of(T, U, (RNG.standard_normal(len(T)) if y is None else y)[:, None])


@pytest.mark.parametrize(
    ("other", "pairs"), [(LEVELS, [(0, 1)]), (3 - 2 * LEVELS, [(0, 1)]), (LEVELS[::-1], []), (0 * LEVELS, [])]
)
def test_inputs_that_move_together_are_a_pair(other, pairs):
    assert excitation.alike(log(np.stack([LEVELS, other], axis=1))) == pairs


@pytest.mark.parametrize(
    ("u", "period"),
    [
        (np.sin(2 * np.pi * T / 2.5), 2.5),
        (np.sin(2 * np.pi * T / 2) + np.sin(2 * np.pi * T / 3), 6.0),
        (np.sign(np.sin(2 * np.pi * T / 4 + 0.01)), 4.0),
        (np.tile(np.repeat(2.0 * max_len_seq(5)[0] - 1, 4), 10)[: len(T)], 6.2),  # a PRBS of 31 bits
        (LEVELS, np.inf),
        (T, np.inf),
    ],
)
def test_an_input_repeats_itself_after_its_period(u, period):
    assert excitation.recurring(log(u), np.array([10.0]))[0] == pytest.approx(period, rel=0.02)
    assert excitation.recurring(log(u), np.array([0.9 * min(period, 20.0)]))[0] == np.inf


def test_a_ramp_and_a_sine_are_smooth_and_steps_are_not():
    u = np.stack([T, np.sin(T), LEVELS, T > 30], axis=1)
    assert excitation.smooth(log(u)).tolist() == [True, True, False, False]


@pytest.mark.parametrize("test_signal", [0.0, 0.5])
def test_a_law_without_a_test_signal_is_seen_in_its_commands(test_signal):
    """Also one with an integral; a plant that follows its commands at once is none."""
    y = 0.5 * np.sin(T) + 0.02 * RNG.standard_normal(len(T))
    u = -2.0 * y - 0.3 * np.cumsum(y) * 0.05 + test_signal * LEVELS
    assert (excitation.followed(log(u, y)) > 0.97) is (test_signal == 0.0)
    assert excitation.followed(log(np.sin(T), y)) < 0.9


@pytest.mark.parametrize("gone", [0.0, 0.5])
def test_a_command_may_be_older_than_its_row_where_rows_are_missing(gone):
    """In the mean by no less than it is; rows that are only irregular miss none."""
    rng, u = np.random.default_rng(1), np.repeat(np.random.default_rng(2).uniform(-1, 1, 240), 5)
    kept = np.append(True, rng.random(len(T) - 1) > gone)
    few = Log.of(T[kept], u[kept, None], u[kept, None])
    changes, seen = T[np.flatnonzero(np.diff(u)) + 1], T[kept][np.flatnonzero(np.diff(u[kept])) + 1]
    older = seen - changes[np.searchsorted(changes, seen, side="right") - 1]
    late = excitation.between_rows(few).late[0]
    assert older.mean() < late < 3 * older.mean() + 0.05 if gone else late == 0
    jittered = T + 0.05 * rng.uniform(-0.3, 0.3, len(T))
    assert excitation.between_rows(Log.of(jittered, u[:, None], u[:, None])).late[0] == 0


@pytest.mark.parametrize(("u", "moving"), [(np.sin(T), True), (LEVELS, False), (RNG.choice([-1.0, 1.0], 1200), False)])
def test_commands_that_move_smoothly_in_most_rows_may_move_between_them(u, moving):
    assert excitation.between_rows(log(u)).moving is moving


def test_errors_follow_the_commands_only_where_the_plant_answers_otherwise_than_the_model():
    segments = Segments.of(log(LEVELS), 40, 1.0)
    noise = np.random.default_rng(3).standard_normal(segments.Y.shape)
    answer = segments.log.arrived(segments.t, np.array([0.9])) - segments.log.arrived(segments.t, np.array([0.4]))
    assert excitation.following(noise, segments, np.array([0.5])) < 0.05
    assert excitation.following(np.cumsum(noise, axis=1), segments, np.array([0.5])) < 0.1
    assert excitation.following(answer + 0.1 * noise, segments, np.array([0.5])) > 0.5
