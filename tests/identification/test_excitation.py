"""What the commands of a log cannot tell, by how they move."""

import numpy as np
import pytest
from scipy.signal import max_len_seq

from npred.identification import excitation
from npred.identification.log import Log

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
