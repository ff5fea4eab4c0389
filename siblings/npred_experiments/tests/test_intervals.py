"""Intervals enclose what the same program gives at points of them."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import npred
from npred.formulas.tape import M, Tape
from npred.formulas.trace import python
from npred_experiments.intervals import Interval, interval

FORMULAS = {
    "sum": lambda a, b: a + b - 2.0,
    "product": lambda a, b: a * b,
    "square": lambda a, b: a * a - b,
    "quotient": lambda a, b: a / (3.0 + b * b) + 1.0 / a,
    "power": lambda a, b: (a * a + 1.0) ** 0.3 + 2.0**b,
    "circle": lambda a, b: M.sin(3.0 * a) + M.cos(5.0 * b) + M.tan(a),
    "growth": lambda a, b: M.exp(a) * M.tanh(b) + M.log(1.5 + M.abs(a)) + M.sqrt(4.0 + a),
    "branches": lambda a, b: M.where(a < b, a * a, M.maximum(a, 2.0 * b)) - M.minimum(b, 0.3) + M.sign(a - b),
    "order": lambda a, b: M.where(a <= 0.1, b, a),
}
ENDS = st.tuples(st.floats(-3, 3), st.floats(0, 4))


@pytest.mark.parametrize("name", FORMULAS)
@settings(deadline=None, derandomize=True)
@given(a=ENDS, b=ENDS, shares=st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=8))
def test_the_values_at_points_are_in_the_interval(name, a, b, shares):
    tape = Tape()
    outputs = [FORMULAS[name](*tape.inputs("x", 2))]
    boxes = [Interval(np.array([low]), np.array([low + width])) for low, width in (a, b)]
    with np.errstate(all="ignore"):
        (enclosed,) = python(outputs, ["x0", "x1"])(*boxes)
        assert enclosed.low <= enclosed.high
        at_points = python(outputs, ["x0", "x1"])
        for share in shares:
            point = [box.low + s * (box.high - box.low) for box, s in zip(boxes, share, strict=True)]
            (value,) = at_points(*point)
            assert np.isnan(value) or enclosed.low <= value <= enclosed.high


@pytest.mark.parametrize("name", FORMULAS)
def test_a_point_is_enclosed_closely(name):
    tape = Tape()
    outputs = [FORMULAS[name](*tape.inputs("x", 2))]
    (enclosed,) = python(outputs, ["x0", "x1"])(0.7, Interval(np.array([0.2]), np.array([0.2])))
    value = python(outputs, ["x0", "x1"])(0.7, np.array([0.2]))[0]
    assert enclosed.low <= value <= enclosed.high
    assert enclosed.high - enclosed.low <= 1e-13 * (1 + abs(value))


def test_what_is_known_of_intervals():
    both = Interval(-1.0, 2.0)
    assert (both * both).low == 0 and (both * both).high == pytest.approx(4)
    assert (both * Interval(-1.0, 2.0)).low == pytest.approx(-2)  # they may differ
    assert np.isinf((1.0 / both).high) and np.isinf((1.0 / both).low)
    assert np.cos(Interval(3.0, 3.3)).low == pytest.approx(-1)
    assert np.cos(Interval(-0.1, 7.0)).high == pytest.approx(1)
    assert np.isinf(np.tan(Interval(1.0, 2.0)).high)
    assert np.isinf(np.log(both).low)


@pytest.mark.parametrize("name", ["activator_repressor", "cart_pole", "chemostat", "planar_arm2"])
def test_a_plants_derivative_on_a_box_holds_those_of_its_points(name):
    plant = npred.plant(name)
    rng = np.random.default_rng(0)
    low, high = np.array(list(plant.box.values())).T
    low = low + 0.4 * (high - low)
    high = low + 0.05 * (high - low)
    box = [Interval(np.array([a]), np.array([b])) for a, b in zip(low, high, strict=True)]
    U = rng.uniform(0.1, 0.3, plant.m)
    enclosed = [interval(a) for a in plant.derivatives["f_x"](*box, *U, 0.0, *plant.p)]
    X = rng.uniform(low, high, (200, plant.n))
    f_X = plant.jacobians(X, np.broadcast_to(U, (200, plant.m)))[0]
    for k, entry in enumerate(enclosed):
        values = f_X[:, k % plant.n, k // plant.n]
        assert (entry.low <= values.min()) and (values.max() <= entry.high)
        assert np.all(entry.high - entry.low < 1e3 * (1 + np.abs(values).max()))


OPERATIONS = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "square": lambda a, b: a * a,
}
NUMBERS = st.floats(1e-3, 1e3) | st.floats(-1e3, -1e-3)


@pytest.mark.parametrize("name", OPERATIONS)
@settings(derandomize=True)
@given(a=NUMBERS, b=NUMBERS)
def test_an_operation_encloses_the_exact_number_that_no_float_is(name, a, b):
    """By rational arithmetic: what NumPy gives at a point is rounded, and would be in an interval of itself alone."""
    exact = OPERATIONS[name](Fraction(a), Fraction(b))
    found = OPERATIONS[name](Interval(a, a), Interval(b, b))
    assert Fraction(float(found.low)) <= exact <= Fraction(float(found.high))
    assert found.high - found.low <= 8 * np.spacing(abs(float(exact)))


@pytest.mark.parametrize("name", ["exp", "log", "sqrt", "tanh", "sin", "cos", "tan"])
@settings(derandomize=True)
@given(a=st.floats(1e-3, 1e2))
def test_a_function_encloses_its_value_in_fifty_digits(name, a):
    with mpmath.workdps(50):
        found, exact = getattr(np, name)(Interval(a, a)), getattr(mpmath, name)(mpmath.mpf(a))
        assert mpmath.mpf(float(found.low)) <= exact <= mpmath.mpf(float(found.high))
