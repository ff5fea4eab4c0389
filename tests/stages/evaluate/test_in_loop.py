"""The prediction error in the loop: what it is of, and that it sees what errors on data do not."""

import numpy as np
import pytest
from jobs import job

from npred import plants
from npred.lab.config.conditions import starts
from npred.lab.stages.evaluate.accuracy import about_in_loop, in_loop, in_loop_error
from npred.loop.closed_loop import simulate
from npred.prediction.methods import RK4, Euler, Predictor

PLANT = plants.resolve("activator_repressor")


@pytest.fixture
def task(tmp_path):
    return job(tmp_path, "evaluate")


def error(task, predictor):
    known = in_loop(task.config, starts(task.config, task.plant))
    return in_loop_error(task.plant, predictor, known, lambda count: None)


def test_it_is_the_largest_over_loops_that_know_the_delay(task):
    begin = starts(task.config, PLANT)
    known = in_loop(task.config, begin)
    states = known.X0
    assert states.tolist() == [[0.03, 30.0], begin.X0[1].tolist(), begin.X0[3].tolist()]
    largest = 0.0
    for X0 in states:
        loop = simulate(PLANT, RK4(PLANT, 21), D=1.0, D_hat=1.0, X0=X0, t_end=6.0, dt=0.01)
        largest = max(largest, np.linalg.norm(loop.P[200:501] - loop.X[300:601], axis=-1).max())
    assert error(task, RK4(PLANT, 21)) == pytest.approx(largest, rel=1e-9) and largest > 0
    assert about_in_loop(PLANT, known).json_object() == {"D": 1.0, "from": 2.0, "to": 5.0, "loops": 3}
    assert known.steps == 3 * 601


def test_a_worse_predictor_has_a_larger_error(task):
    assert error(task, Euler(PLANT, 21)) > 10 * error(task, RK4(PLANT, 21))


def test_delays_are_rounded_to_control_steps(tmp_path):
    """X(t + D) is on a step; a delay below a step, or longer than the loop, leaves something to measure too."""
    begin = starts(job(tmp_path, "any").config, PLANT)
    for D, delay, length in ((0.994, 0.99, 6.0), (0.001, 0.01, 0.4), (3.0, 3.0, 12.0)):
        known = in_loop(job(tmp_path, f"{D}", evaluate={"D": D, "bounds": (0.001, 4.0)}).config, begin)
        assert pytest.approx(delay) == known.D and known.t_end == pytest.approx(length)
        about = about_in_loop(PLANT, known)
        assert about.start < about.to
    rounded = about_in_loop(PLANT, in_loop(job(tmp_path, "some", evaluate={"D": 0.6, "dt": 0.025}).config, begin))
    assert (rounded.D, rounded.start, rounded.to) == (0.6, 1.2, 5.4)


class Lost(Predictor):
    """Predicts nothing finite."""

    name = "lost"

    def predict(self, X, u, D_hat, t):
        return np.full((*u.shape[:2], X.shape[-1]), np.nan)

    def lanes(self):
        def predict(X, u, D_hat, t, p, P):
            P[:] = np.nan

        return predict


def test_a_loop_that_is_lost_has_no_finite_error(task):
    assert error(task, Lost(PLANT, 21)) == np.inf
