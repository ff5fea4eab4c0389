"""Transport is exact: the actuator state is the history of U read at t + D (x - 1)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from npred.base import grid
from npred.loop import actuator
from npred.plants.inputs import Past

DT = 0.01


class Line:
    """A delay line of one lane, fed step by step."""

    def __init__(self, D, u0=0.0, nx=11):
        self.D, self.k = np.array([[D]]), 0
        self.origin, self.held, self.total = actuator.history(self.D.max(), self.D.max(), DT, Past(np.array([[u0]])))
        self.u, self.u_nodes = np.empty((nx, 1, 1)), np.empty((nx, 1, 1))
        self.out = [np.empty((1, 1)) for _ in range(3)]

    def read(self):
        """The means over the nodes' cells, and the values at the nodes."""
        actuator.transport(self.origin + self.k, DT, self.D, self.held, self.total, self.u, self.u_nodes)
        return self.u[:, 0, 0].copy(), self.u_nodes[:, 0, 0].copy()

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


@given(D=st.floats(0.02, 1.0), nx=st.integers(2, 40))
@settings(max_examples=50)
def test_u_carries_cell_means_on_any_grid(D, nx):
    """The mean of the held input over each node's cell, by the exact integral of the staircase."""
    line, inputs = Line(D, nx=nx), np.random.default_rng(3).normal(size=150)
    for U in inputs:
        line.feed(U)
    edges = np.concatenate([[0.0], (np.arange(nx - 1) + 0.5) / (nx - 1), [1.0]])
    position = 150 + D / DT * (edges - 1)  # in control steps
    integral = np.interp(position, np.arange(-150, 151), np.concatenate([np.zeros(150), [0.0], np.cumsum(inputs)]))
    u, _ = line.read()
    np.testing.assert_allclose(u, np.diff(integral) / np.diff(position), rtol=0, atol=1e-6)


@given(D=st.floats(0.02, 1.0), nx=st.integers(2, 120))
@settings(max_examples=50)
def test_u_nodes_are_linear_between_the_starts_of_steps(D, nx):
    line, inputs = Line(D, nx=nx), np.random.default_rng(4).normal(size=150)
    for U in inputs:
        line.feed(U)
    position = 150 + D / DT * (grid.nodes(nx) - 1)
    _, u_nodes = line.read()
    np.testing.assert_allclose(u_nodes, np.interp(position, np.arange(150), inputs), rtol=0, atol=1e-6)


@pytest.mark.parametrize("nx", [11, 50, 51, 201])
def test_the_integral_of_the_input_is_kept(nx):
    """The trapezoidal rule on cell means is the exact integral of the held input, on coarse and fine grids."""
    line, inputs = Line(0.5, nx=nx), np.random.default_rng(5).normal(size=100)
    for U in inputs:
        line.feed(U)
    assert grid.trapezoid(nx) @ line.read()[0] == pytest.approx(inputs[50:].mean(), abs=1e-13)


def test_before_the_start_the_input_is_u0():
    line = Line(0.3, u0=0.7, nx=5)
    np.testing.assert_allclose(line.read(), 0.7, rtol=1e-14)


def test_without_a_delay_all_nodes_have_the_newest_command():
    line = Line(0.0, nx=5)
    for U in (0.3, -0.2, 0.9):
        line.feed(U)
    np.testing.assert_array_equal(line.read(), np.full((2, 5), 0.9))


@given(D=st.floats(0.0, 0.5))
@settings(max_examples=30)
def test_the_input_that_acts_is_the_mean_of_what_leaves_the_delay(D):
    """The integral of the staircase from k - D / dt to one step later; without a delay, of the newest command."""
    line, inputs, U = Line(D, u0=0.4), np.random.default_rng(8).normal(size=80), np.empty((1, 1))
    total = np.concatenate([0.4 * np.arange(-60.0, 0.0), [0.0], np.cumsum(inputs)])
    for k, sent in enumerate(inputs):
        line.feed(sent)
        actuator.acting(line.origin + k, DT, line.D, line.held, U)
        position = k - D / DT + np.array([0.0, 1.0])
        assert U[0, 0] == pytest.approx(np.diff(np.interp(position, np.arange(-60, 81), total))[0], abs=1e-6)


def test_inputs_with_delays_of_their_own_are_two_lines():
    D, random = np.array([[0.213], [0.5]]), np.random.default_rng(11)
    lines = [Line(d, nx=7) for d in D[:, 0]]
    origin, rows, total = actuator.history(D.max(), D.max(), DT, Past(np.zeros((1, 2))))
    reads, out = [np.empty((7, 2, 1)) for _ in range(2)], [np.empty((2, 1)) for _ in range(3)]
    for k, U in enumerate(random.normal(size=(90, 2, 1))):
        actuator.actuate(origin + k, DT, D, U, rows, total, *out)
        fed = [line.feed(float(value)) for line, value in zip(lines, U[:, 0], strict=True)]
        np.testing.assert_allclose(np.array(out)[:, :, 0].T, fed, rtol=0, atol=1e-12)
    actuator.transport(origin + 90, DT, D, rows, total, *reads)
    for read, alone in zip(reads, zip(*[line.read() for line in lines], strict=True), strict=True):
        np.testing.assert_allclose(read[:, :, 0].T, alone, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("delay", "reads"), [(np.nan, 0.0), (-1.0, 0.0), (1e300, 1.75), (np.inf, 1.75)])
@pytest.mark.parametrize("k", [7, 21])
def test_a_delay_that_the_buffers_do_not_hold_reads_the_end_of_them(delay, reads, k):
    """That of a loop that ended is NaN: it may read anything of its history, but nothing beyond it."""
    commands, rows = np.arange(k + 1.0) ** 2, np.arange(k - 7, k + 1) % 8
    held, total = np.empty((8, 1, 1)), np.empty((8, 1, 1))
    held[rows, 0, 0], total[rows, 0, 0] = commands[-8:], (np.cumsum(commands) - commands)[-8:]
    both = [np.empty((5, 1, 1)) for _ in range(4)]
    for D, (u, u_nodes) in ((delay, both[:2]), (reads, both[2:])):
        actuator.transport(k, 0.25, np.array([[D]]), held, total, u, u_nodes)
    np.testing.assert_array_equal(both[0], both[2])
    np.testing.assert_array_equal(both[1], both[3])
