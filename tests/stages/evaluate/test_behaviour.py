"""What an evaluation says of loops that are known: medians, not means, of the cases; the map of loops that converge."""

from types import SimpleNamespace

import pytest
from jobs import job
from known_loops import NEVER, known_loops

from npred import plants
from npred.lab.config.results import NUMERICAL, PredictorId
from npred.lab.stages.evaluate import behaviour

PLANT = plants.resolve("scalar", {"a": 0.5, "c": 2.0})  # at rest at 0, where a control error of e moves it by e / 2
FNO = PredictorId("fno")


def test_scores_are_medians_over_the_cases(tmp_path):
    """The loop shown, five cases, two of the map; a case that the numerical predictor has at rest gives no ratio."""
    begin = SimpleNamespace(cases=slice(1, 6), map=slice(6, 6))
    runs = {
        NUMERICAL: known_loops([9, 10, 20, 40, 0, 50, 9, 9], [0.0] * 8),
        FNO: known_loops([9, 20, 30, 80, 7, NEVER, NEVER, NEVER], [0.002, 0.001, 0.004, 0.006, 0.003, 1, 1, 1]),
    }
    config = job(tmp_path, "evaluate").config.evaluate
    scores = behaviour.scores(PLANT, config, begin, FNO, 0.03, runs)
    radius = scores["radius"]
    assert (radius.median, radius.worst, radius.cases, radius.count) == (0.004, 1.0, 5, 4)
    assert radius.predicted == pytest.approx(0.5 * 0.03)
    assert scores["settle_time"] == 30.0  # of 20, 30, 80, 7 and one that does not
    assert scores["settle_ratio"] == 2.0  # of 2, 1.5, 2 and an infinite one
    assert scores["figure1"].radius == 1.0 and scores["map"] is None  # within t_end = 4 s it does not settle


def test_a_delay_is_in_the_band_where_no_loop_is_lost_that_numerics_keep(tmp_path):
    """Three delays, two estimates: at the second delay both lose a loop, at the third the network loses another."""
    table = {"map_D": [0.5, 1.0, 1.5], "map_D_hat": [0.6, 0.7]}
    config, home = job(tmp_path, "map", evaluate=table).config.evaluate, 9
    exact = known_loops([home, home, home, NEVER, home, home], [0.0] * 6)
    run = known_loops([home, home, home, NEVER, NEVER, home], [0.0] * 6)
    found = behaviour.delay_map(plants.resolve("scalar"), config, run, exact)
    assert found.converged == [[True, True], [True, False], [False, True]]
    assert found.band == (0.5, 1.0) and found.share == pytest.approx(4 / 5)
    assert behaviour.delay_map(plants.resolve("scalar"), config, exact, run).share == 1.0
