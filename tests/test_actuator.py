"""Transport is exact: the actuator state is the history of U read at t + D (x - 1)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from npred import actuator, grid

DT = 0.01


class Line:
    """A delay line of one lane, fed step by step."""

    def __init__(self, D, u0=0.0, nx=11):
        self.D, self.k = np.array([[D]]), 0
        self.origin, self.held, self.total = actuator.history(self.D, DT, np.array([[u0]]))
        self.u = np.empty((nx, 1, 1))
        self.out = [np.empty((1, 1)) for _ in range(3)]

    def read(self):
        actuator.transport(self.origin + self.k, DT, self.D, self.held, self.total, self.u)
        return self.u[:, 0, 0].copy()

    def feed(self, U):
        """Hold U for a step; the input that leaves: before the switch, after it, and the share before it."""
        actuator.actuate(self.origin + self.k, DT, self.D, np.array([[U]]), self.held, self.total, *self.out)
        self.k += 1
        return float(self.out[0][0, 0]), float(self.out[1][0, 0]), float(self.out[2][0, 0])


def held(values, u0, s):
    """The held input at position s, in steps."""
    return u0 if s < 0 else values[int(np.floor(s))]


@given(steps=st.integers(0, 40), u0=st.floats(-1, 1))
@settings(max_examples=30)
def test_whole_steps_come_out_exactly_after_the_delay(steps, u0):
    line, inputs = Line(steps * DT, u0), np.random.default_rng(steps).normal(size=120)
    for k, U in enumerate(inputs):
        before, _, share = line.feed(U)
        assert share == 1.0
        assert before == held(inputs, u0, k - steps)


@given(D=st.floats(0.003, 0.5))
@settings(max_examples=30)
def test_a_switch_inside_a_step_splits_it(D):
    line, inputs = Line(D), np.random.default_rng(7).normal(size=80)
    for k, U in enumerate(inputs):
        before, after, share = line.feed(U)
        s = k - D / DT
        assert before == held(inputs, 0.0, s + 1e-7)
        if share < 1.0:
            assert after == held(inputs, 0.0, s + 1)
            assert share == pytest.approx(np.floor(s) + 1 - s, abs=1e-9)


def test_a_fine_grid_reads_points():
    """dx D <= dt: u(x_j) = U(t + D (x_j - 1))."""
    line, inputs = Line(0.1, nx=11), np.arange(1.0, 31.0)
    for U in inputs:
        line.feed(U)
    np.testing.assert_array_equal(line.read(), [*inputs[20:30], inputs[29]])


@given(D=st.floats(0.2, 1.0), nx=st.integers(3, 12))
@settings(max_examples=30)
def test_a_coarse_grid_carries_cell_means(D, nx):
    line, inputs = Line(D, nx=nx), np.random.default_rng(3).normal(size=150)
    for U in inputs:
        line.feed(U)
    u, cell = line.read(), D / DT / (nx - 1)
    if cell <= 1.0 + 1e-6:
        return
    for j, x in enumerate(grid.nodes(nx)):
        s = 150 + D / DT * (x - 1)
        low, high = max(s - cell / 2, 150 - D / DT), min(s + cell / 2, 150.0)
        fine = np.linspace(low, high, 20001)
        mean = np.mean([inputs[min(int((a + b) / 2), 149)] for a, b in zip(fine, fine[1:], strict=False)])
        assert u[j] == pytest.approx(mean, abs=2e-3)


def test_the_integral_of_the_input_is_kept():
    """The trapezoidal rule on cell means is the exact integral of the held input."""
    line, inputs = Line(0.5, nx=11), np.random.default_rng(5).normal(size=100)
    for U in inputs:
        line.feed(U)
    assert grid.trapezoid(11) @ line.read() == pytest.approx(inputs[50:].mean(), abs=1e-13)


def test_before_the_start_the_input_is_u0():
    line = Line(0.3, u0=0.7, nx=5)
    np.testing.assert_allclose(line.read(), 0.7, rtol=1e-14)


def test_inputs_with_delays_of_their_own_are_two_lines():
    D, random = np.array([[0.213], [0.5]]), np.random.default_rng(11)
    lines = [Line(d, nx=7) for d in D[:, 0]]
    origin, rows, total = actuator.history(D, DT, np.zeros((2, 1)))
    u, out = np.empty((7, 2, 1)), [np.empty((2, 1)) for _ in range(3)]
    for k, U in enumerate(random.normal(size=(90, 2, 1))):
        actuator.actuate(origin + k, DT, D, U, rows, total, *out)
        fed = [line.feed(float(value)) for line, value in zip(lines, U[:, 0], strict=True)]
        np.testing.assert_allclose(np.array(out)[:, :, 0].T, fed, rtol=0, atol=1e-12)
    actuator.transport(origin + 90, DT, D, rows, total, u)
    np.testing.assert_allclose(u[:, :, 0].T, [line.read() for line in lines], rtol=0, atol=1e-12)
