"""Programs lowered operation by operation give the numbers of the interpreter."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit, types

from npred.symbolic import called_functions, lowering
from npred.symbolic.programs import lines
from npred.symbolic.tape import OPS, M, Tape

REALS = st.floats(0.1, 5) | st.floats(-5, -0.1) | st.just(0.0)
CONDITIONS = ("lt", "le")
NUMBERS = [op for op in OPS if op not in CONDITIONS]


def compiled(text, count, size):
    """What takes an array of `count` floats to a list of `size`."""
    lowered = lowering.function(text, size)
    signature = types.UniTuple(types.float64, size)(types.UniTuple(types.float64, count))
    called = njit(signature, error_model="numpy")(lambda floats: lowered(floats))
    return lambda *floats: called(tuple(float(x) for x in floats))


def every_operation(o, a, b):
    arguments = {1: (a,), 2: (a, b), 3: (o.lt(a, b), a, b)}
    return tuple(getattr(o, op)(*arguments[OPS[op].arity]) for op in NUMBERS)


all_at_once = compiled(every_operation, 2, len(NUMBERS))


def expected(op, a, b):
    arguments = {1: (a,), 2: (a, b), 3: (a < b, a, b)}[OPS[op].arity]
    try:
        found = OPS[op].value(*arguments)
    except ZeroDivisionError:
        return None  # by the sign of zero, an infinity or NaN: what NumPy makes of it is the next test
    except ValueError:
        return math.nan
    return math.nan if isinstance(found, complex) else found


@given(REALS, REALS)
def test_every_operation_is_that_of_the_interpreter(a, b):
    for op, found in zip(NUMBERS, all_at_once(a, b), strict=True):
        value = expected(op, a, b)
        if value is not None and (op, a) != ("log", 0.0):
            np.testing.assert_allclose(found, value, rtol=4e-16, err_msg=f"{op} of {a}, {b}")


def test_edges_are_those_of_floating_point():
    found = dict(zip(NUMBERS, all_at_once(0.0, 0.0), strict=True))
    assert math.isnan(found["div"]) and found["log"] == -math.inf and found["pow"] == 1.0
    found = dict(zip(NUMBERS, all_at_once(math.nan, 1.0), strict=True))
    assert math.isnan(found["add"]) and math.isnan(found["sin"]) and math.isnan(found["abs"])


@pytest.mark.parametrize(("a", "b", "less", "at_most"), [(1, 2, 1, 1), (2, 2, 0, 1), (3, 2, 0, 0)])
def test_conditions_choose(a, b, less, at_most):
    def choose(o, a, b):
        return o.where(o.lt(a, b), 1.0, 0.0), o.where(o.le(a, b), 1.0, 0.0), 7.5

    assert compiled(choose, 2, 3)(a, b) == (less, at_most, 7.5)


@given(st.lists(st.floats(-2, 2), min_size=3, max_size=3))
def test_a_trace_in_these_texts_is_the_function(values):
    np.testing.assert_allclose(traced(*values), function(*values), rtol=1e-14, atol=1e-14)


def function(x, y, z, M=np):
    swing = M.sin(x) * y + 2.0 * M.cos(z) ** 2
    return [swing, M.where(x <= y, swing / (1.0 + z * z), -abs(z)), M.maximum(x, M.tanh(y)), 0.25]


def from_the_tape():
    tape = Tape()
    x, y, z = tape.inputs("x", 3)
    told = lines(function(x, y, z, M), {f"x{k}": f"x{k}" for k in range(3)}, ["y0", "y1", "y2", "y3"],
                    called_functions.TEXTS)  # fmt: skip
    namespace = {}
    text = "def text(o, x0, x1, x2):\n    " + "\n    ".join(told) + "\n    return y0, y1, y2, y3\n"
    exec(text, namespace)
    return compiled(namespace["text"], 3, 4)


traced = from_the_tape()
