"""Which grids a guard takes, by numbers that are known: what each costs, what it lets pass, where it is misled."""

from types import SimpleNamespace

import numpy as np
import pytest

from npred.predictors import guard_examples
from npred.predictors.guard_examples import Examples

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
    monkeypatch.setattr(guard_examples, "_operations", lambda exact, steps: WHOLE)

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
