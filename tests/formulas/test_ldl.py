"""Systems of equations: solved on arrays, tensors and symbols, and differentiated through the same factors."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from npred.formulas import array_math, ldl, programs, tape
from npred.formulas.trace import python


def system(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    root = random.normal(size=(n, n))
    return root @ root.T + np.eye(n), random.normal(size=n)


@given(st.integers(1, 7), st.integers(0, 100))
def test_the_solution_solves(n, seed):
    A, b = system(n, seed)
    np.testing.assert_allclose(ldl.solve(A.tolist(), b.tolist()), np.linalg.solve(A, b), rtol=1e-8, atol=1e-10)


def equations(x, y, M):
    """Two equations whose matrix and right side depend on x and y, and their solution times x."""
    A = [[2 + M.sin(x), 0.3 * y], [0.3 * y, 3 + x * x]]
    return [x * z for z in M.solve(A, [M.cos(y), x * y])]


def test_arrays_and_tensors_are_solved_side_by_side():
    x, y = np.linspace(-1, 1, 5), np.linspace(0, 2, 5)
    expected = [[equations(a, b, array_math.NUMPY)[k] for a, b in zip(x, y, strict=True)] for k in (0, 1)]
    np.testing.assert_allclose(equations(x, y, array_math.NUMPY), expected, rtol=1e-14)
    tensors = torch.tensor(x), torch.tensor(y)
    np.testing.assert_allclose(torch.stack(equations(*tensors, array_math.of(tensors[0]))), expected, rtol=1e-14)


@pytest.mark.parametrize(("x", "y"), [(0.3, 0.8), (-0.9, 1.7)])
def test_the_derivative_equals_differences_and_factors_once(x, y):
    t = tape.Tape()
    at, along = [t.input("x"), t.input("y")], [t.input("dx"), t.input("dy")]
    outputs = equations(*at, tape.M)
    slope = programs.derivative(outputs, at, along)
    h, d = 1e-6, (0.6, -1.1)
    ends = [equations(x + s * h * d[0], y + s * h * d[1], array_math.NUMPY) for s in (1, -1)]
    differences = (np.array(ends[0]) - np.array(ends[1])) / (2 * h)
    np.testing.assert_allclose(python(slope, ["x", "y", "dx", "dy"])(x, y, *d), differences, rtol=1e-8)
    divisions = sum(
        " / " in line for line in programs.lines(slope, {name: name for name in ("x", "y", "dx", "dy")}, "ab")
    )
    assert divisions == 2  # one a pivot, for the solution and its derivative together


def test_numbers_alone_are_solved_on_the_tape_too():
    assert tape.M.solve([[2.0]], [1.0]) == [0.5]


def test_a_solution_that_is_its_right_side_keeps_the_rule_of_that():
    t = tape.Tape()
    x = t.input("x")
    (y,) = tape.M.solve([[1.0]], [x * x])
    assert python(programs.derivative([y], [x], [1.0]), ["x"])(3.0) == [6.0]
