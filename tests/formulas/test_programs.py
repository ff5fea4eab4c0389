"""Programs equal the functions they were traced from, and their derivatives equal differences."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from npred.formulas import programs, tape
from npred.formulas.tape import M
from npred.formulas.trace import python

VALUES = st.floats(0.2, 2.0)


def mixture(x, y, M):
    """Every operation at once, smooth on the box of VALUES."""
    a = M.sin(x) * M.cos(y) + M.exp(-x * y) / (1 + x**2) - M.tanh(y) + M.tan(x / 4)
    b = M.log(1 + x) + M.sqrt(y) + x**3 - y**-2 + x**1.5 + x**0.3 + 2**y + abs(x - 3) + M.abs(y - 3)
    return [a, b, a * b - M.maximum(a, a + 1) + M.minimum(b, b - 1), M.where(x < y + 10, a, b), M.sign(x) * +y - (-y)]


def traced(function, derivative=False):
    t = tape.Tape()
    x, y = t.input("x"), t.input("y")
    outputs = function(x, y, M)
    if derivative:
        outputs = programs.derivative(outputs, [x, y], [t.input("vx"), t.input("vy")])
        return python(outputs, ["x", "y", "vx", "vy"])
    return python(outputs, ["x", "y"])


class Floats:
    """The same mathematics on floats, independent of the tape."""

    sin, cos, tan, exp, log, sqrt, tanh, abs = (
        math.sin,
        math.cos,
        math.tan,
        math.exp,
        math.log,
        math.sqrt,
        math.tanh,
        abs,
    )
    maximum, minimum, pi = max, min, math.pi
    sign = staticmethod(lambda a: float(np.sign(a)))
    where = staticmethod(lambda c, a, b: a if c else b)


@given(VALUES, VALUES)
def test_program_equals_function(x, y):
    np.testing.assert_allclose(traced(mixture)(x, y), mixture(x, y, Floats), rtol=1e-13, atol=1e-13)


@given(VALUES, VALUES, st.floats(-1, 1), st.floats(-1, 1))
def test_derivative_equals_central_difference(x, y, vx, vy):
    h = 1e-6
    ahead, behind = (np.array(mixture(x + s * h * vx, y + s * h * vy, Floats)) for s in (1, -1))
    np.testing.assert_allclose(
        traced(mixture, derivative=True)(x, y, vx, vy), (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-6
    )


@pytest.mark.parametrize("above", [lambda x, y: M.cos(x - y), lambda x, y: 0.0], ids=["node of its own", "zero"])
def test_derivative_of_a_solution_reads_what_the_solution_reads(above):
    """Equal to the derivative by Cramer's rule, whatever stands above the diagonal."""

    def solved(x, y, M):
        return M.solve([[2 + x * x, above(x, y)], [M.cos(y - x), 3.0]], [x, M.sin(y)])

    def cramer(x, y, M):
        a, b, c = 2 + x * x, M.cos(y - x), M.sin(y)
        return [(3 * x - b * c) / (3 * a - b * b), (a * c - b * x) / (3 * a - b * b)]

    found, wanted = (traced(function, derivative=True)(0.7, 1.9, 1.0, -0.5) for function in (solved, cramer))
    np.testing.assert_allclose(found, wanted, rtol=1e-13)


def test_what_no_output_needs_is_not_printed():
    t = tape.Tape()
    x = t.input("x")
    unused, used = M.exp(x), x + 1
    assert unused is not used
    lines = programs.lines([used], {"x": "x"}, ["y"])
    assert not any("exp" in line for line in lines)
    assert programs.depends([used], [x]) and not programs.depends([used], [unused])
