"""The map of loops that converge, on loops that are known."""

import pytest
from jobs import job
from known_loops import NEVER, known_loops

from npred import plants
from npred.stages.evaluate import behaviour


def test_a_delay_is_in_the_band_where_no_loop_is_lost_that_numerics_keep(tmp_path):
    """Three delays, two estimates: at the second delay both lose a loop, at the third the contender loses another."""
    table = {"map_D": [0.5, 1.0, 1.5], "map_D_hat0": [0.6, 0.7]}
    config, home = job(tmp_path, "map", evaluate=table).config.evaluate, 9
    exact = known_loops([home, home, home, NEVER, home, home], [0.0] * 6)
    run = known_loops([home, home, home, NEVER, NEVER, home], [0.0] * 6)
    found = behaviour.delay_map(plants.resolve("scalar"), config, run, exact)
    assert found.converged == [[True, True], [True, False], [False, True]]
    assert found.band == (0.5, 1.0) and found.share == pytest.approx(4 / 5)
    assert behaviour.delay_map(plants.resolve("scalar"), config, exact, run).share == 1.0
