"""Methods on few cells: the lines that they read, order, jumps; and which grids a guard takes, by known numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from stiff_plants import Sprung

import npred
from npred.base import grid
from npred.base.errors import ConfigError
from npred.plants import Plant
from npred.prediction.methods import method
from npred.prediction.methods.coarse import Coarse, Examples, straight

SPRUNG = Plant("sprung", Sprung)


def test_the_lines_are_those_of_least_squares():
    """Each node stands for the cell around it, half a cell at the ends; cells that cut these in any place."""
    rng, fine = np.random.default_rng(0), 4000
    u = rng.normal(size=(2, 21, 3))
    for count in (1, 3, 7):
        s = (np.arange(count * fine) + 0.5) / (count * fine) * 20
        dense = u[:, np.minimum((s + 0.5).astype(int), 20)]
        found = straight(u, count)
        for J in range(count):
            part = slice(J * fine, (J + 1) * fine)
            z = (s[part] - J * 20 / count) / (20 / count)
            for row in range(2):
                slope, begin = np.polyfit(z, dense[row, part], 1)
                np.testing.assert_allclose(found[row, 2 * J], begin, atol=2e-3)
                np.testing.assert_allclose(found[row, 2 * J + 1], begin + slope, atol=2e-3)


@pytest.mark.parametrize("name", ["heun", "rosenbrock", "semi_implicit"])
def test_the_order_holds_where_u_jumps_inside_a_cell(name):
    """Of a mass on a damper that is not stiff; by reading u at nodes it would be 1."""
    plant, X, nx, counts = Plant("sprung", Sprung, {"drag": 3.0}), [0.2, 0.5], 2001, np.array([10, 20, 40, 80])
    u, P = [], []

    def f(t, P, held):
        return plant.f(P, np.array([held]))

    for node in range(800, 1000, 17):
        u.append(np.where(np.arange(nx) < node, -1.0, 2.0)[:, None])
        place, end = (node - 0.5) / (nx - 1), np.array(X)  # where the nodes' cells change
        for span, held in (((0, place), -1.0), ((place, 1), 2.0)):
            end = solve_ivp(f, span, end, args=(held,), rtol=1e-11, atol=1e-13).y[:, -1]
        P.append(end)
    errors = [np.abs(Coarse(plant, method(name), n, nx)(X, np.array(u), 1.0)[:, -1] - P).max() for n in counts]
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] > 1.7
    assert errors[0] < 5e-3


def test_between_the_ends_of_cells_P_is_a_straight_line():
    u = np.sin(3 * grid.nodes(41))[:, None]
    P = Coarse(SPRUNG, method("rosenbrock"), 4, 41)([0.0, 0.5], u, 1.0)
    np.testing.assert_array_equal(P[0], [0.0, 0.5])
    np.testing.assert_allclose(np.diff(P[10:21], 2, axis=0), 0.0, atol=1e-15)


def test_a_plant_that_reads_nodes_alone_is_refused():
    with pytest.raises(ConfigError, match="coarse: expected a traced plant with one constant delay, got unicycle"):
        Coarse(npred.plant("unicycle"), method("heun"), 4)


class Known(Examples):
    """Examples whose U by a method on so many cells is known."""

    U = {}

    def on_cells(self, name, count):
        return self.U[name, count][:, None]


def known(count):
    nobody = np.zeros(count)
    return Known(SimpleNamespace(kappa=lambda P, t: P), nobody, np.zeros((count, 51, 1)), nobody, nobody)


def test_a_step_is_short_enough_for_all_but_one_of_a_hundred_examples(monkeypatch):
    ends = {50: np.zeros(200), 100: np.random.default_rng(0).permutation(200).astype(float)}
    monkeypatch.setattr(Known, "U", {("rk4", count): U for count, U in ends.items()})
    assert known(200).move("rk4", 50) == 198.0
    ends[50][:3] = np.nan
    assert known(200).move("rk4", 50) == np.inf
