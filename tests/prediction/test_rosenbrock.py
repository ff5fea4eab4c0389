"""Elimination with exchanges by selection: against NumPy, on numbers and traced, with zeros on the diagonal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from npred.formulas import tape
from npred.formulas.trace import python
from npred.prediction.methods import rosenbrock


@given(seed=st.integers(0, 10**6), size=st.integers(1, 7), sparse=st.floats(0.0, 0.6))
@settings(max_examples=80, deadline=None)
def test_solutions_are_those_of_numpy(seed, size, sparse):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(size, size)), rng.normal(size=(2, size))
    A[rng.random((size, size)) < sparse] = 0.0
    A += np.roll(np.eye(size), 1, axis=1) * 3.0  # regular without its diagonal
    if np.linalg.cond(A) > 1e6:
        return
    solve = rosenbrock.solver(A.tolist())
    for right in b:
        np.testing.assert_allclose(solve(right.tolist()), np.linalg.solve(A, right), rtol=1e-8, atol=1e-8)


def test_a_pivot_that_vanishes_is_exchanged_in_a_traced_program():
    """The text knows no values: the same program serves matrices with another largest entry in each column."""
    on = tape.Tape()
    entries, b = on.inputs("a", 9), on.inputs("b", 3)
    y = rosenbrock.solver([entries[:3], entries[3:6], entries[6:]])(b)
    program = python(y, [*tape.names("a", 9), *tape.names("b", 3)])
    rng = np.random.default_rng(3)
    for shift in range(3):
        A = np.roll(np.diag([2.0, -3.0, 5.0]), shift, axis=0) + np.roll(np.diag([0.0, 1e-3, 0.0]), 1, axis=1)
        right = rng.normal(size=3)
        np.testing.assert_allclose(program(*A.ravel(), *right), np.linalg.solve(A, right), rtol=1e-12)


def test_rows_that_are_known_to_be_of_the_identity_cost_no_search_and_zeros_no_product():
    on = tape.Tape()
    h, spring, drag, b = (*on.inputs("c", 3), on.inputs("b", 2))
    y = rosenbrock.solver([[1.0, -h], [h * spring, 1.0 + h * drag]])(b)
    operations = [op for op, _ in on.nodes]
    assert "where" not in operations and operations.count("div") == 1
    program = python(y, ["c0", "c1", "c2", "b0", "b1"])
    expected = np.linalg.solve([[1.0, -0.5], [1.0, 4.0]], [1.0, 2.0])
    assert program(0.5, 2.0, 6.0, 1.0, 2.0) == pytest.approx(expected)
