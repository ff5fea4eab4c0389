"""Nodes and quadrature on [0, 1]."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from npred.base import grid

SIZES = st.integers(2, 400)


@given(SIZES)
def test_both_ends_are_nodes_and_the_spacing_is_even(nx: int):
    x = grid.nodes(nx)
    assert (x[0], x[-1], len(x)) == (0.0, 1.0, nx)
    np.testing.assert_allclose(np.diff(x), 1 / (nx - 1), rtol=1e-9)


@given(SIZES, st.floats(-5, 5), st.floats(-5, 5))
def test_the_quadrature_is_exact_for_straight_lines(nx: int, a: float, b: float):
    integral = grid.trapezoid(nx) @ (a + b * grid.nodes(nx))
    assert integral == pytest.approx(a + b / 2, abs=1e-12)


def test_the_quadrature_is_of_second_order():
    errors = [abs(grid.trapezoid(nx) @ np.exp(grid.nodes(nx)) - np.expm1(1)) for nx in (11, 21, 41, 81)]
    orders = np.diff(np.log2(errors))
    np.testing.assert_allclose(orders, -2, atol=0.02)


@pytest.mark.parametrize(("dx", "nx"), [(0.01, 101), (0.005, 201), (0.001, 1001), (0.5, 3)])
def test_dx_counts_both_ends(dx: float, nx: int):
    assert grid.count(dx) == nx
    assert np.diff(grid.nodes(nx))[0] == pytest.approx(dx)


@pytest.mark.parametrize(("old", "nx"), [(5, 9), (21, 101), (101, 21), (7, 7)])
def test_refine_is_exact_on_cubics_and_keeps_nodes(old, nx):
    def cubic(x):
        return np.stack([1 - 2 * x + 3 * x**2 - 4 * x**3, x], axis=-1)

    np.testing.assert_allclose(grid.refine(cubic(grid.nodes(old)), nx), cubic(grid.nodes(nx)), atol=1e-13)


def test_refine_is_linear_on_few_nodes_and_takes_batches():
    values = np.array([[[0.0], [1.0], [0.0]], [[2.0], [2.0], [4.0]]])
    refined = grid.refine(values, 5)
    np.testing.assert_allclose(refined[..., 0], [[0, 0.5, 1, 0.5, 0], [2, 2, 2, 3, 4]], atol=1e-14)
