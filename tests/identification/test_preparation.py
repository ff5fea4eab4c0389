"""Segments that are short enough, and steps that are fine enough."""

import numpy as np
import pytest

import npred
from npred.identification.identify import Settings, prepared
from npred.identification.log import Log


def log(period: float, count: int = 900) -> Log:
    rng, t = np.random.default_rng(0), period * np.arange(count)
    return Log.of(t, rng.uniform(-1, 1, (count, 1)), rng.uniform(-1, 1, (count, 1)))


def of_rate(rate: float) -> npred.plants.Plant:
    class Rate:
        states, inputs, box = ("X",), ("U",), {"X": (-1.0, 1.0)}

        def f(x, u, t, p, M):
            return [rate * x.X + M.sin(x.X) * u.U]

        def kappa(x, t, p, M):
            return [-x.X]

    return npred.plants.make("rate", Rate)


@pytest.mark.parametrize(("rate", "longest"), [(-1.0, 0.05 * 30), (3.0, np.log(30) / 3), (1.0, 0.05 * 30)])
def test_an_error_of_the_begin_grows_by_thirty_in_a_segment_at_most(rate, longest):
    problem, _ = prepared(of_rate(rate), log(0.05), Settings(longest=0.5))
    spans = problem.segments.t[:, -1] - problem.segments.t[:, 0]
    assert 0.6 * longest < spans.max() <= longest + 0.05


@pytest.mark.parametrize("period", [0.05, 0.5])
def test_half_as_long_steps_change_no_state_by_what_the_noise_would_let_one_see(period):
    problem, _ = prepared(of_rate(-4.0), log(period), Settings(longest=4 * period))
    X, theta = problem.start()
    pieces = problem.segments.pieces([2 * period])
    steps = problem.model.steps
    x, finer = (type(problem.model)(problem.model.plant, problem.model.free, steps=k).states(X, theta, pieces)
                for k in (steps, 8 * steps))  # fmt: skip
    assert np.mean(np.abs(x - finer) < 0.02 * problem.scale) > 0.98 and (steps > 1) == (period > 0.1)
