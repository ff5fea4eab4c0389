"""Newton's method in the sizes of a plant: its path, its bound, and what these sizes are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import npred
from npred.plants import newton

POWERS = st.integers(-12, 12).map(lambda k: 10.0**k)


def path(z):
    """Rosenbrock's two equations, 0 at (1, 1)."""
    return np.array([10 * (z[1] - z[0] ** 2), 1 - z[0]]), np.array([[-20 * z[0], 10.0], [-1.0, 0.0]])


@settings(max_examples=50, deadline=None)
@given(st.tuples(POWERS, POWERS), st.tuples(POWERS, POWERS), st.tuples(st.floats(-2, 2), st.floats(-2, 2)))
def test_the_search_is_the_same_in_all_units_of_equations_and_unknowns(rows, units, start):
    rows, units = np.array(rows), np.array(units)

    def F(z):
        value, slope = path(z / units)
        return rows * value, rows[:, None] * slope / units

    z, arrived = newton.search(F, np.array(start) * units, units)
    assert arrived
    np.testing.assert_allclose(z / units, [1.0, 1.0], rtol=1e-12)


def test_a_search_ends_within_its_bound_where_there_is_no_zero():
    calls = []

    def F(z):
        calls.append(z)
        return np.array([z[0] ** 2 + 1.0]), np.array([[2 * z[0]]])

    z, arrived = newton.search(F, np.array([3.0]), np.ones(1))
    assert not arrived and abs(z[0]) < 0.1 and len(calls) <= newton.CORRECTIONS + 1


def test_no_step_that_failed_is_tried_twice(monkeypatch):
    """F is z - 1, so z is s; in its second half only steps of a quarter come through."""
    tried = []

    def corrected(F, goal, z, *more):
        there = 1.0 + goal[0]
        tried.append((z[0], there))
        arrives = there <= 0.5 or there - z[0] <= 0.25
        return (np.array([there]), 1, True) if arrives else (z, 1, False)

    monkeypatch.setattr(newton, "_corrected", corrected)
    assert newton.search(lambda z: (z - 1.0, np.eye(1)), np.zeros(1), np.ones(1))[1]
    assert tried == [(0.0, 1.0), (0.0, 0.5), (0.5, 1.0), (0.5, 0.75), (0.75, 1.0)]


@pytest.mark.parametrize("rate", [0.0, 1e-9])
def test_an_equation_that_nothing_moves_must_hold_already(rate):
    F = lambda z: (np.array([z[0] - 1.0, rate]), np.array([[1.0, 0.0], [0.0, 0.0]]))
    assert newton.search(F, np.zeros(2), np.ones(2))[1] == (rate == 0)


def test_a_zero_without_a_derivative_is_one():
    F = lambda z: (np.sqrt(np.abs(z)), np.array([[np.inf]]))
    assert newton.search(F, np.zeros(1), np.ones(1))[1]


@settings(max_examples=20, deadline=None)
@given(POWERS, POWERS)
def test_sizes_that_are_not_declared_follow_from_those_that_are(second, size):
    """An oven has no bounds of its heat, which 0.4 times the temperature balances; nor has the rate of a cart a box."""

    class Oven:
        states, inputs, box = ("T", "load"), ("heat",), {"T": (0.0, 100.0 * size)}

        def f(x, u, t, p, M):
            return [(u.heat - 0.4 * x.T / size) * size / second, (0.1 * x.T / size - x.load) / second]

    np.testing.assert_allclose(npred.plant(Oven).scales, [50.0 * size, 5.0, 20.0], rtol=1e-12)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_root_at_its_guess_tells_no_size_and_warns_of_nothing():
    class Tank:
        states, inputs, box = ("h",), ("q",), {"h": (0.05, 2.0)}

        def f(x, u, t, p, M):
            return [u.q - M.sqrt(x.h)]

    np.testing.assert_allclose(npred.plant(Tank).scales, [0.975, 1.0])


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_an_overflow_on_the_way_ends_the_search_without_a_warning():
    F = lambda z: (np.exp(400 * z) * np.array([1e300]), np.array([[np.inf]]))
    assert not newton.search(F, np.array([3.0]), np.ones(1))[1]
