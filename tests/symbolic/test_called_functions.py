"""Functions of costly plants, compiled on their own, operation by operation, and called by the kernels."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit, types

from npred import plants, predictors
from npred.loop.adaptation import DelayAdaptation
from npred.loop.closed_loop import simulate
from npred.plants.base import Plant
from npred.plants.builtin.planar_arm import arm
from npred.symbolic import called_functions
from npred.symbolic.programs import lines
from npred.symbolic.tape import OPS, M, Tape

REALS = st.floats(0.1, 5) | st.floats(-5, -0.1) | st.just(0.0)
CONDITIONS = ("lt", "le")
NUMBERS = [op for op in OPS if op not in CONDITIONS]


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


def compiled(text, count, size):
    """What takes an array of `count` floats to a list of `size`."""
    lowered = called_functions.lowered_function(text, size)
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
    text = lines(function(x, y, z, M), {f"x{k}": f"x{k}" for k in range(3)}, ["y0", "y1", "y2", "y3"],
                    called_functions.TEXTS)  # fmt: skip
    namespace = {}
    source = "def text(o, x0, x1, x2):\n    " + "\n    ".join(text) + "\n    return y0, y1, y2, y3\n"
    exec(source, namespace)
    return compiled(namespace["text"], 3, 4)


traced = from_the_tape()
