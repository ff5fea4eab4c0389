"""How predictors read u between nodes: its mean is kept, no value leaves those of the nodes, and no jump spikes U."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import npred
from npred.base import grid
from npred.base.registry import METHODS
from npred.plants import Plant
from npred.prediction import methods as predictors
from npred.prediction.delays import problem_of

INTEGRATOR = npred.plant("scalar", a=0.0)
SERVED = [name for name in METHODS.builtin if name != "euler" and problem_of(INTEGRATOR).refusal(name) is None]
values = st.lists(st.floats(-10, 10), min_size=2, max_size=12)


class Unstable:
    """exp(2 D) = 7.4: an error at the begin of the delay is that much larger at its end."""

    states, inputs, box = ("x",), ("u",), {"x": (-1, 1)}
    f = lambda x, u, t, p, M: [2 * x.x + u.u]
    kappa = lambda x, t, p, M: [-8 * x.x]


class Stepped:
    """A pendulum whose reference jumps."""

    states, inputs, box = ("x", "v"), ("u",), {"x": (-1, 1), "v": (-1, 1)}
    f = lambda x, u, t, p, M: [x.v, u.u - M.sin(x.x)]

    def kappa(x, t, p, M):
        aim = M.where(t > 3, -0.5, M.where(t > 1.5, 1.0, 0.0))
        return [M.sin(x.x) - 4 * (x.x - aim) - 4 * x.v]


class Saturated:
    """A double integrator at its bounds for most of the time."""

    states, inputs, box = ("x", "v"), ("u",), {"x": (-1, 1), "v": (-1, 1)}
    input_bounds = ((-1.0, 1.0),)
    f = lambda x, u, t, p, M: [x.v, u.u]
    kappa = lambda x, t, p, M: [-9 * x.x - 6 * x.v]


class Stiff:
    """Two rates."""

    states, inputs, box = ("x", "y"), ("u",), {"x": (-1, 1), "y": (-1, 1)}
    f = lambda x, u, t, p, M: [-20 * (x.x - u.u), x.x + x.y * x.y]
    kappa = lambda x, t, p, M: [-3 * x.y - x.y * x.y - 0.05 * x.x]


class Relay:
    """Almost a switch."""

    states, inputs, box = ("x",), ("u",), {"x": (-1, 1)}
    f = lambda x, u, t, p, M: [x.x + u.u]
    kappa = lambda x, t, p, M: [-2 * M.tanh(20 * x.x)]


class Chain:
    """Three integrators and a square."""

    states, inputs, box = ("a", "b", "c"), ("u",), {"a": (-1, 1), "b": (-1, 1), "c": (-1, 1)}
    f = lambda x, u, t, p, M: [x.b, x.c, u.u + 0.5 * x.a**2]
    kappa = lambda x, t, p, M: [-0.5 * x.a**2 - 8 * x.a - 12 * x.b - 6 * x.c]


# D and the start; None: the delay is the plant's own
LOOPS = {
    Unstable: (1.0, [1.0]), Stepped: (0.5, [0.5, 0.0]), Saturated: (0.4, [1.0, 0.5]), Stiff: (0.5, [0.3, 0.5]),
    Relay: (0.3, [0.7]), Chain: (0.4, [0.3, 0.1, 0.0]),
    "scalar": (0.5, [1.0]), "van_der_pol": (0.3, [1.0, 0.0]), "cart_pole": (0.3, [0.2, 0.1, 0.1, 0.0]),
    "chemostat": (1.5, [2.0, 2.0]), "activator_repressor": (1.0, [0.03, 30.0]), "unicycle": (0.6, [1.0, 0.5, 0.5]),
    "planar_arm2": (0.3, None), "strict_feedforward3": (1.0, None), "pvtol": (0.2, None),
    "transport_tank": (None, None), "unicycle_time_delay": (None, [1.0, 0.5, 0.5]),
}  # fmt: skip


def loop(of, nx: int):
    """t and U of a loop by the default method, 8 D long."""
    plant = npred.plant(of) if isinstance(of, str) else Plant(of.__name__.lower(), of)
    D, X0 = LOOPS[of]
    if X0 is None:
        X0 = [low + 0.8 * (high - low) for low, high in (plant.box[name] for name in plant.states)]
    delays = {} if plant.declares_delay else {"D": D, "D_hat": D}
    t_end = 5.0 if D is None else max(8 * D, 4.0)
    run = npred.simulate(plant, npred.predictor(plant, "rk4", nx), X0=X0, t_end=t_end, **delays)
    return run.t[: len(run.U)], run.U


@pytest.mark.slow
@pytest.mark.parametrize("of", LOOPS, ids=lambda of: of if isinstance(of, str) else of.__name__)
def test_the_default_nodes_give_U_as_many_nodes_do_whatever_jumps(of):
    """U on 101 nodes is within 1 % of its range of that on 3001, from D / 2 on, and moves by no more than twice as much
    in a control step.
    """
    (t, few), (_, many) = loop(of, 101), loop(of, 3001)
    late = t >= (LOOPS[of][0] or 0.5) / 2
    assert (np.abs(few - many)[late].max(axis=0) <= 0.01 * np.ptp(many[late], axis=0)).all()
    steps, finer = (np.abs(np.diff(U, axis=0))[late[1:]] for U in (few, many))
    assert (steps.max(axis=0) <= 2 * finer.max(axis=0)).all()


@pytest.mark.parametrize("method", SERVED)
@given(u=values, D_hat=st.floats(0.1, 2))
@settings(max_examples=30)
def test_the_mean_of_u_is_kept_by_every_method_but_eulers(method, u, D_hat):
    """X' = U: P(1) is X + D_hat times the mean of u, of which the nodes at the ends stand for half a cell."""
    P = predictors.numerical(method, INTEGRATOR, len(u))([1.0], np.array(u)[:, None], D_hat)
    shares = grid.trapezoid(len(u))
    np.testing.assert_allclose(P[-1, 0], 1 + D_hat * shares @ u, atol=1e-10)


@given(u=values)
def test_a_line_stays_between_the_two_nodes_of_its_cell(u):
    nodes = np.array(u)[:, None]
    low, high = np.minimum(nodes[:-1], nodes[1:]), np.maximum(nodes[:-1], nodes[1:])
    for end in grid.lines(nodes):
        assert (end >= low - 1e-12).all() and (end <= high + 1e-12).all()


@given(place=st.floats(0.25, 0.75), before=st.floats(-5, 5), after=st.floats(-5, 5))
def test_a_jump_inside_a_cell_is_where_its_mean_says(place, before, after):
    """A held input that jumps once: the mean of each interval between nodes, up to the one with the jump, is exact."""
    nx = 21
    edges = np.clip((np.arange(nx + 1) - 0.5) / (nx - 1), 0.0, 1.0)
    total = before * np.minimum(edges, place) + after * np.maximum(edges - place, 0.0)
    begin, end = grid.lines((np.diff(total) / np.diff(edges))[:, None])
    x = grid.nodes(nx)
    exact = np.diff(before * np.minimum(x, place) + after * np.maximum(x - place, 0.0)) * (nx - 1)
    np.testing.assert_allclose((begin + end)[:, 0] / 2, exact, atol=1e-9 * (1 + abs(before) + abs(after)))


@given(u=values, nx=st.integers(2, 30))
def test_means_on_other_nodes_have_the_same_mean(u, nx):
    other = grid.means(np.array(u)[:, None], nx)
    assert other.shape == (nx, 1)
    np.testing.assert_allclose(grid.trapezoid(nx) @ other, grid.trapezoid(len(u)) @ np.array(u)[:, None], atol=1e-10)
    assert other.min() >= min(u) - 1e-9 and other.max() <= max(u) + 1e-9
