"""Methods on few cells: the lines that they read, order, jumps; and which grids a guard takes, by known numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from stiff_plants import Sprung

import npred
from npred import grid
from npred.errors import ConfigError
from npred.plants import Plant
from npred.predictors import coarse, method
from npred.predictors.coarse import Coarse, Examples, straight

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


PASSING, TOLERANCE, WHOLE = 0.4, 0.1, 100
MODEL = np.array([0.0, 0.1, 0.35, 2.0])  # U of the model for four examples; that of `exact` is 0
NOBODY = np.zeros(4)


def shadow(R, noise):
    """U on 2 N and N steps whose extrapolation is R and that differ by `noise`."""
    A = np.asarray(R) - noise / 3
    return A, A - noise


class Known(Examples):
    """Examples whose U by a method on so many cells is known, and what each method costs on one."""

    U, cost = {}, ()

    def by_cost(self, names):
        return [(cost, name, 1) for name, cost in self.cost]

    def on_cells(self, name, count):
        return self.U[name, count][:, None]


def known(count):
    nobody = np.zeros(count)
    return Known(SimpleNamespace(kappa=lambda P, t: P), nobody, np.zeros((count, 51, 1)), nobody, nobody)


@pytest.fixture
def chosen(monkeypatch):
    """The grids that are chosen of some, each with its cost and its two U."""
    monkeypatch.setattr(coarse, "_operations", lambda exact, steps: WHOLE)

    def choose(options):
        monkeypatch.setattr(Known, "cost", [(name, cost) for name, cost, _ in options])
        U = {(name, count): U for name, _, pair in options for count, U in zip((2, 1), pair, strict=True)}
        monkeypatch.setattr(Known, "U", U)
        model, exact = (lambda *calls, U=U: U[:, None, None] for U in (MODEL, 0 * MODEL))
        return known(4).shadow(model, exact, [], PASSING, TOLERANCE)[0]

    return choose


def test_what_does_not_pass_costs_a_fallback(chosen):
    """The noise of `b` keeps one more example from passing: 20 + 0.5 * 100 against 30 + 0.25 * 100."""
    assert chosen([("b", 20, shadow(NOBODY, 0.2)), ("c", 30, shadow(NOBODY, 0.01))]) == "c"
    assert chosen([("b", 20, shadow(NOBODY, 0.02)), ("c", 30, shadow(NOBODY, 0.01))]) == "b"


def test_one_example_that_misleads_is_enough(chosen):
    """`a` is right but for one example of small noise, where it is 0.2 off; where its noise is large, that is seen."""
    off = np.array([0.2, 0.0, 0.0, 0.0])
    assert chosen([("a", 10, shadow(off, 0.03)), ("c", 30, shadow(NOBODY, 0.01))]) == "c"
    assert chosen([("a", 10, shadow(off, np.array([0.5, 0.03, 0.03, 0.03]))), ("c", 39, shadow(NOBODY, 0.01))]) == "a"


def test_a_shadow_as_dear_as_the_fallback_is_not_taken_where_another_is_misled_less(chosen):
    """Beyond 0.4 of what `exact` costs there is no use: of those below, the one that is misled least."""
    options = [("a", 10, shadow(NOBODY + 0.3, 0.03)), ("b", 20, shadow(NOBODY + 0.2, 0.03))]
    assert chosen([*options, ("c", 41, shadow(NOBODY, 0.01))]) == "b"
    assert chosen([*options, ("c", 40, shadow(NOBODY, 0.01))]) == "c"


def test_a_step_is_short_enough_for_all_but_one_of_a_hundred_examples(monkeypatch):
    ends = {50: np.zeros(200), 100: np.random.default_rng(0).permutation(200).astype(float)}
    monkeypatch.setattr(Known, "U", {("rk4", count): U for count, U in ends.items()})
    assert known(200).move("rk4", 50) == 198.0
    ends[50][:3] = np.nan
    assert known(200).move("rk4", 50) == np.inf
