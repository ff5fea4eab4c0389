"""Formulas in C: every operation is that of the interpreter, long functions are called, edges are those of IEEE 754."""

import ctypes
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from npred.formulas.tape import OPS, M, Tape
from npred.kernels import compiler
from npred.kernels.c_text import single
from npred.kernels.formula import function, vector
from npred.kernels.kernel import made, skeleton

REALS = st.floats(0.1, 5) | st.floats(-5, -0.1) | st.just(0.0)
CONDITIONS = ("lt", "le")
NUMBERS = [op for op in OPS if op not in CONDITIONS]
BODY = """
static inline void KERNEL(Shape d, const double *X, double t, double *U, double *work)
{
    const double p[1] = {0.0};
    (void)t, (void)work;
    for (int l = 0; l < d.lanes; l++) {
        F(d.lanes, X + l, p, U + l);
    }
}
"""


def compiled(outputs, count):
    """What takes `count` floats to the values of outputs of x0, x1, …"""
    text = function("{name}", outputs, [vector("x", count)], {"y": len(outputs)}, 1)
    kernel = made("formula", "X, t, &U", BODY, {"F": text})

    def call(*values):
        U = np.empty((len(outputs), 3))
        kernel(np.tile(np.array(values, dtype=float)[:, None], 3), 0.0, U)
        assert ((U[:, :1] == U) | np.isnan(U)).all()  # all lanes alike
        return U[:, 0].tolist()

    return call


def arity(op):
    """The number of its arguments."""
    return OPS[op].text.count("{")


def every_operation():
    a, b = (tape := Tape()).inputs("x", 2)
    arguments = {1: (a,), 2: (a, b), 3: (tape.node("lt", (a, b)), a, b)}
    return [tape.node(op, arguments[arity(op)]) for op in NUMBERS]


all_at_once = compiled(every_operation(), 2)


def expected(op, a, b):
    arguments = {1: (a,), 2: (a, b), 3: (a < b, a, b)}[arity(op)]
    try:
        found = OPS[op].value(*arguments)
    except ZeroDivisionError:
        return None  # by the sign of zero, an infinity or NaN
    except ValueError:
        return math.nan
    return math.nan if isinstance(found, complex) else found


@given(REALS, REALS)
def test_every_operation_is_that_of_the_interpreter(a, b):
    for op, found in zip(NUMBERS, all_at_once(a, b), strict=True):
        value = expected(op, a, b)
        if value is not None and (op, a) != ("log", 0.0):
            np.testing.assert_allclose(found, value, rtol=9e-16, err_msg=f"{op} of {a}, {b}")


def test_edges_are_those_of_floating_point():
    found = dict(zip(NUMBERS, all_at_once(0.0, 0.0), strict=True))
    assert math.isnan(found["div"]) and found["log"] == -math.inf and found["pow"] == 1.0
    found = dict(zip(NUMBERS, all_at_once(math.nan, 1.0), strict=True))
    assert math.isnan(found["add"]) and math.isnan(found["sin"]) and math.isnan(found["abs"])


@pytest.mark.parametrize(("a", "b", "less", "at_most"), [(1, 2, 1, 1), (2, 2, 0, 1), (3, 2, 0, 0)])
def test_conditions_choose(a, b, less, at_most):
    x, y = (tape := Tape()).inputs("x", 2)
    chosen = [M.where(tape.node(op, (x, y)), 1.0, 0.0) for op in CONDITIONS]
    assert compiled([*chosen, 7.5, math.inf, -math.inf], 2)(a, b) == [less, at_most, 7.5, math.inf, -math.inf]


@given(st.lists(st.floats(-2, 2), min_size=3, max_size=3))
def test_a_trace_is_the_function(values):
    np.testing.assert_allclose(traced(*values), swings(*values, np), rtol=1e-14, atol=1e-14)


def swings(x, y, z, M):
    swing = M.sin(x) * y + 2.0 * M.cos(z) ** 2
    return [swing, M.where(x <= y, swing / (1.0 + z * z), -abs(z)), M.maximum(x, M.tanh(y)), 0.25]


traced = compiled(swings(*Tape().inputs("x", 3), M), 3)


def test_in_single_precision_types_numbers_and_functions_change_and_nothing_else():
    text = "double x2 = sqrt(0.5) * 1e-300 + larger(y[2], 3.0); int k = 2; /* double */ const double z = pow(x2, 1.5);"
    assert single(text) == (
        "float x2 = sqrtf(0.5f) * 1.1754944e-38f + larger(y[2], 3.0f); int k = 2; /* float */ "
        "const float z = powf(x2, 1.5f);"
    )


TURNS = """
void entry(int count, const double *x, double *y)
{
    for (int k = 0; k < count; k++) {
        y[k] = sine(x[k]);
        y[count + k] = cosine(x[k]);
    }
}
"""


def turns(x, text=lambda text: text):
    """sine and cosine of x (count,), as rows, in the precision of x."""
    entry = compiler.library(text(skeleton("base.h") + TURNS)).entry
    y = np.empty((2, len(x)), dtype=x.dtype)
    entry(len(x), *(ctypes.c_void_p(a.ctypes.data) for a in (x, y)))
    return y


@pytest.mark.parametrize("size", [1e-300, 1e-3, 1.0, 10.0, 1e3, 5e5])
def test_sine_and_cosine_are_right_to_two_units_in_the_last_place(size):
    x = np.random.default_rng(0).uniform(-size, size, 10_000)
    for found, name in zip(turns(x), ("sin", "cos"), strict=True):
        exact = np.array([getattr(math, name)(value) for value in x])
        assert (np.abs(found - exact) <= 2 * np.spacing(np.abs(exact))).all()


def test_sine_and_cosine_of_large_numbers_stay_bounded_and_of_infinite_ones_are_nan():
    x = np.array([1e16, -1e100, 1.7e308, math.inf, -math.inf, math.nan])
    found = turns(x)
    assert (np.abs(found[:, :3]) <= 1).all() and np.isnan(found[:, 3:]).all()


def test_sine_and_cosine_in_single_precision():
    x = np.random.default_rng(0).uniform(-50, 50, 10_000).astype(np.float32)
    wide = x.astype(float)
    np.testing.assert_allclose(turns(x, single), [np.sin(wide), np.cos(wide)], rtol=0, atol=4e-6)  # the last place of x
