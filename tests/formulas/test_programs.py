"""Programs, systems of equations and the tape equal the functions they were traced from, derivatives differences."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from npred import plants
from npred.estimation.adaptation import DelayAdaptation
from npred.formulas import array_math, called_functions, ldl, programs, tape
from npred.formulas.tape import M
from npred.formulas.trace import python
from npred.loop.closed_loop import simulate
from npred.plants.base import Plant
from npred.plants.builtin.planar_arm import arm
from npred.prediction import methods as predictors

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

    solved = lambda x, y, M: M.solve([[2 + x * x, above(x, y)], [M.cos(y - x), 3.0]], [x, M.sin(y)])

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


def test_equal_operations_are_stored_once():
    t = tape.Tape()
    x = t.input("x")
    before = len(t.nodes)
    assert (M.sin(x) * 2 + M.sin(x) * 2) is not None
    assert len(t.nodes) == before + 3  # sin, times two, sum


def test_constants_fold_and_zeros_vanish():
    t = tape.Tape()
    x = t.input("x")
    assert M.sin(0.0) == 0.0
    assert not isinstance(x * 0, tape.Symbol)
    assert x * 0 == 0.0
    assert (x + 0).index == x.index and (x * 1).index == x.index and (x / 1).index == x.index
    assert len(t.nodes) == 1


def test_powers_are_products():
    t = tape.Tape()
    lines = programs.lines([t.input("x") ** 5], {"x": "x"}, ["y"])
    assert not any("**" in line for line in lines)


@pytest.mark.parametrize(
    "misuse", [lambda x: max(x, 1), lambda x: math.sin(x), lambda x: 1 if x else 2, lambda x: x == 1, lambda x: int(x)]
)
def test_a_decision_on_a_symbol_names_the_cure(misuse):
    with pytest.raises(TypeError, match=r"M\."):
        misuse(tape.Tape().input("x"))


def test_unknown_mathematics_is_named():
    with pytest.raises(AttributeError, match=r"M: expected one of pi, sin, cos.*; did you mean tan"):
        M.tahn(1.0)


def test_arrays_of_symbols_are_elementwise():
    t = tape.Tape()
    x = np.array(t.inputs("x", 2), dtype=object)
    y = t.input("h") / 2 * x + 1
    assert y.shape == (2,)
    assert python(y, ["x0", "x1", "h"])(3.0, 5.0, 4.0) == [7.0, 11.0]


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


def test_functions_are_called_where_they_are_long():
    assert called_functions.called(plants.resolve("planar_arm5")) == ("f", "kappa")
    assert (
        called_functions.called(plants.resolve("planar_arm2"))
        == called_functions.called(plants.resolve("cart_pole"))
        == ()
    )


@pytest.mark.parametrize("method", ["rk4", "picard"])
def test_kernels_that_call_f_are_those_that_hold_it(method, monkeypatch):
    """The update law, the loop and the predictor, once with f written out and once with it called."""
    runs = []
    for length in (10, 10**6):
        monkeypatch.setattr(called_functions, "LONG", length)
        plant = Plant("chain", arm(2))
        loop = simulate(plant, predictors.numerical(method, plant, 11), D=0.2, D_hat=0.3, X0=plant.target(0.0) + 0.1,
                        t_end=1.0, dt=0.01, adaptation=DelayAdaptation(gamma=1.0, bounds=(0.1, 0.3)))  # fmt: skip
        runs.append(np.concatenate([loop.X, loop.U, loop.D_hat[:, None]], axis=1))
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-10, atol=1e-12)
    assert np.ptp(runs[0][:, -1]) > 1e-3
