"""The tape: what is stored, what folds, what is refused."""

import math

import numpy as np
import pytest

from npred.formulas import programs, tape
from npred.formulas.tape import M
from npred.formulas.trace import python


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
    with pytest.raises(AttributeError, match=r"M: expected one of pi, where, solve, sin.*; did you mean sin"):
        M.sinh(1.0)


def test_arrays_of_symbols_are_elementwise():
    t = tape.Tape()
    x = np.array(t.inputs("x", 2), dtype=object)
    y = t.input("h") / 2 * x + 1
    assert y.shape == (2,)
    assert python(y, ["x0", "x1", "h"])(3.0, 5.0, 4.0) == [7.0, 11.0]
