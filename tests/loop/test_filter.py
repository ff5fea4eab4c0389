"""The safety filter: where nothing would break a limit nothing changes, the least change by a solver of SciPy, limits
kept in loops, and loops that are not lost by it.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

import npred
from npred.base.errors import ConfigError
from npred.loop.safety import filter as grid
from npred.plants import Plant
from npred.plants.builtin.cart_pole import CartPole
from npred.prediction.methods import RK4


class Cart:
    """A mass on a track of 1 m to either side, sent to 0.05 m before its end."""

    states, inputs = ("x", "v"), ("u",)
    box, input_bounds = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}, ((-5.0, 5.0),)
    f = lambda x, u, t, p, M: [x.v, u.u]
    kappa = lambda x, t, p, M: [-4 * (x.x - 0.95) - 1.2 * x.v]
    safe = lambda x, t, p, M: [1.0 - x.x, 1.0 + x.x]


class Pole(CartPole):
    """A pole on a cart, whose track alone is limited."""

    parameters = CartPole.parameters | {"mass": 0.2, "length": 0.4}
    box = {"p": (-0.5, 0.5), "v": (-0.2, 0.2), "theta": (-0.15, 0.15), "omega": (-0.2, 0.2)}
    input_bounds = ((-25.0, 25.0),)
    safe = lambda x, t, p, M: [0.6 - x.p, 0.6 + x.p]


CART, POLE = Plant("cart", Cart), npred.plant(Pole, kappa="lqr")


def filtered(plant, safety, P, U, dt=0.01):
    """U (B, m), the plans (B, blocks * (m + 1)), the least h, where U was changed and where in vain, of states P (B, n)
    when U acts, at t = 0.
    """
    B, bounds = len(P), np.array(plant.input_bounds)
    lanes = [np.array(a.T, order="C") for a in (P, U)]
    ends, low, high = lanes[0][None].copy(), *(np.repeat(bounds[:, [k]], B, axis=1) for k in (0, 1))
    (kept, changed, *promise), unkept = np.empty((4, B)), np.zeros(B)
    plan = np.zeros((safety.axes(plant)["plan"], B))
    numbers = safety.numbers(plant, dt, bounds)["safety"]
    protect = safety.kernels(plant)["protect"]
    protect(ends, np.zeros((1, B)), plant.p, numbers, low, high, lanes[1], plan, kept, changed, unkept, *promise)
    return lanes[1].T, plan.T[:, : grid.BLOCKS * (plant.m + 1)], kept, changed, unkept


def least_h(plant, x, U, dt, seconds):
    """The least h of a loop of kappa, held over steps of dt in its bounds, whose first input is U: by SciPy."""
    least, (low, high) = np.inf, np.array(plant.input_bounds).T
    for _ in range(round(seconds / dt)):
        path = solve_ivp(lambda t, y, U=U: plant.f(y, U), (0, dt), x, rtol=1e-9, atol=1e-12)
        x = path.y[:, -1]
        least, U = min(least, plant.safe(x).min()), np.clip(plant.kappa(x), low, high)
    return least


@pytest.mark.parametrize(("plant", "spread"), [(CART, [0.9, 0.9]), (POLE, [0.55, 0.4, 0.15, 0.4])])
def test_u_is_changed_only_where_the_loop_without_would_break_a_limit(plant, spread):
    P = np.random.default_rng(3).uniform(-1, 1, (40, plant.n)) * spread
    P = P[(plant.safe(P) > 0).all(axis=-1)]
    U = np.clip(plant.kappa(P), *np.array(plant.input_bounds).T)
    after, _, kept, changed, _ = filtered(plant, npred.SafetyFilter(), P, U)
    free = np.array([least_h(plant, x, u, 0.01, 3.0) for x, u in zip(P, U, strict=True)])
    assert not changed[free > 2e-3].any() and (changed == 0).sum() > 3
    assert (changed > 0).sum() >= 0.7 * (free < -2e-3).sum() > 2  # a plan may also begin later
    assert (after[changed == 0] == U[changed == 0]).all() and np.array_equal(kept, plant.safe(P).min(axis=-1))


def test_the_plan_is_the_least_that_keeps_the_limits():
    """Of a linear plant, by SLSQP and matrix exponentials, kappa held over steps a tenth as long as the filter's."""
    dt, (start, v0) = 0.01, (0.2, 1.1)
    U = CART.kappa(np.array([start, v0]))
    after, plan, _, changed, unkept = filtered(CART, npred.SafetyFilter(), np.array([[start, v0]]), U[None], dt)
    edges, v = np.split(plan[0], [grid.BLOCKS])
    lengths, fine = np.diff(edges, prepend=0.0), 0.002
    times = np.arange(0, 4.0, fine)
    block = np.minimum(np.searchsorted(edges, times, side="right"), grid.BLOCKS - 1)

    def path(v):
        x, xs = np.array([start, v0]), []
        for j in block:
            u = -4 * (x[0] - 0.95) - 1.2 * x[1] + v[j]
            x = np.array([x[0] + fine * x[1] + fine**2 / 2 * u, x[1] + fine * u])
            xs.append(x[0])
        return np.array(xs)

    base, unit = path(np.zeros(grid.BLOCKS)), np.eye(grid.BLOCKS)
    slopes = np.stack([path(row) - base for row in unit], axis=1)  # the loop is linear in v
    found = minimize(
        lambda v: (v**2) @ lengths, np.zeros(grid.BLOCKS), jac=lambda v: 2 * v * lengths, method="SLSQP",
        constraints={"type": "ineq", "fun": lambda v: 1 - 0.002 - base - slopes @ v, "jac": lambda v: -slopes},
        options={"maxiter": 500, "ftol": 1e-12},
    )  # fmt: skip
    assert changed[0] and not unkept[0] and found.success
    assert (v**2) @ lengths == pytest.approx((found.x**2) @ lengths, rel=0.02)
    assert v[0] == pytest.approx(found.x[0], abs=0.05 * np.abs(found.x).max())
    assert after[0, 0] == pytest.approx(U[0] + v[0], abs=1e-12)


def loops(plant, X0, safety, D, t_end, dt=0.005, nx=31, **named):
    named = {"D": D, "D_hat": D, "u0": [0.0], "actuator": "history", "progress": False} | named
    return npred.simulate(plant, RK4(plant, nx), X0=X0, t_end=t_end, dt=dt, safety=safety, **named)


def from_box(plant, count, seed=0):
    low, high = np.array([plant.box[name] for name in plant.states]).T
    return np.random.default_rng(seed).uniform(low, high, (count, plant.n))


def test_a_track_never_drops_the_pole_and_nothing_changes_where_the_loop_keeps_it():
    X0, first = from_box(POLE, 60), 24  # the first state that a command meets
    free, loop = (loops(POLE, X0, safety, 0.12, 14.0) for safety in (None, npred.SafetyFilter()))
    inside = (free.safety[:, first:] >= 0).all(axis=(1, 2))
    assert 45 < inside.sum() < 57
    assert (loop.U[inside] == free.U[inside]).all() and not loop.filtered[inside].any()
    assert np.abs(loop.X[:, -1]).max() < 0.05
    kept = (loop.safety[~inside, first:] >= 0).all(axis=(1, 2))
    assert kept.sum() >= 0.7 * len(kept) and free.safety[~inside][kept].min() < -0.1
    assert kept[loop.unkept[~inside] == 0].all()


def test_a_set_point_beyond_a_limit_rests_on_it_without_swinging():
    class Wall(Cart):
        input_bounds = ((-500.0, 500.0),)
        kappa = lambda x, t, p, M: [-40 * (x.x - 0.95) - 12 * x.v]
        safe = lambda x, t, p, M: [0.5 - x.x]

    loop = loops(Plant("wall", Wall), [0.0, 0.0], npred.SafetyFilter(), 0.3, 5.0, 0.01)
    assert np.abs(loop.U[-100:]).max() < 1e-6 and not loop.unkept
    assert loop.safety[30:].min() > 0 and loop.safety[-1, 0] < 0.002


class Cubic:
    states, inputs, box = ("x",), ("u",), {"x": (-0.5, 0.5)}
    f = lambda x, u, t, p, M: [x.x + 1.5 * x.x**3 + u.u]
    kappa = lambda x, t, p, M: [-x.x - 1.5 * x.x**3 - 4.0 * (x.x - 1.2)]
    safe = lambda x, t, p, M: [1.0 - x.x**2]


@pytest.mark.parametrize("nx", [31, 101, 201])
def test_limits_do_not_depend_on_the_nodes(nx):
    """The filter follows the commands themselves."""
    loop = loops(Plant("cubic", Cubic), [0.0], npred.SafetyFilter(), 0.6, 5.0, 0.01, nx)
    assert loop.safety.min() > 0 and not loop.unkept and loop.filtered.any()


def test_what_the_steps_cannot_predict_is_not_promised():
    class Stiff(Cart):
        f = lambda x, u, t, p, M: [x.v, u.u - 400 * M.sin(60 * x.x)]

    loop = loops(Plant("stiff", Stiff), [0.1, 0.0], npred.SafetyFilter(), 0.3, 0.5, 0.1)
    assert loop.unkept == loop.steps


class Valve:
    """A flow that the valve scales: where nothing flows, no input moves the limit."""

    states, inputs = ("q",), ("u",)
    box, input_bounds = {"q": (0.0, 2.0)}, ((-1.0, 1.0),)
    f = lambda x, u, t, p, M: [x.q * u.u]
    kappa = lambda x, t, p, M: [0.5 - x.q]
    safe = lambda x, t, p, M: [x.q - 0.2]


def test_a_limit_that_no_input_moves_is_unkept_and_changes_nothing():
    loop = loops(Plant("valve", Valve), [0.0], npred.SafetyFilter(), 0.2, 1.0, 0.01, 11)
    assert loop.changes == 0 and loop.unkept == loop.steps


@pytest.mark.parametrize("alpha", [None, 0.5, 2.0])
def test_a_limit_that_is_broken_is_kept_again_at_the_laws_rate_or_at_alpha(alpha):
    class Slow(Valve):
        box, input_bounds = {"q": (0.0, 1.0)}, ((-5.0, 5.0),)
        f = lambda x, u, t, p, M: [u.u]
        kappa = lambda x, t, p, M: [0.1 * (0.9 - x.q)]
        safe = lambda x, t, p, M: [x.q - 0.8]

    loop = loops(Plant("slow", Slow), [0.0], npred.SafetyFilter(alpha), 0.2, 4.0, 0.02)
    free = loops(Plant("slow", Slow), [0.0], None, 0.2, 4.0, 0.02)
    h, t = loop.safety[10:, 0], loop.t[10:] - loop.t[10]
    assert loop.unkept > 0
    if alpha is None:
        assert (loop.X == free.X).all()
    else:
        assert (h >= h[0] * np.exp(-alpha * t) - 2e-3).all()  # and no sooner than it has to, as the law would not be
        assert (h <= h[0] * np.exp(-1.2 * alpha * t) + 0.03).all()


@pytest.mark.parametrize("margin", [0.0, 0.2])
@pytest.mark.parametrize(("D", "delay"), [(0.3, 0.0), (0.28, 0.02), (0.32, 0.02)])
def test_limits_and_their_margin_are_kept_for_any_delay_in_its_interval(D, delay, margin):
    X0 = from_box(CART, 60) * 0.7
    free, loop = (
        loops(CART, X0, safety, D, 6.0, 0.01, D_hat=0.3)
        for safety in (None, npred.SafetyFilter(margin=margin, delay=delay))
    )
    first = round(D / 0.01) + 1
    promised = loops(CART, X0, npred.SafetyFilter(margin=margin, delay=delay), D, 0.01, 0.01, D_hat=0.3).unkept == 0
    assert promised.sum() > 30 and free.safety[promised].min() < -0.1
    assert loop.safety[promised, first:].min() > margin - 1e-6


@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_a_controller_filters_as_the_simulated_loop(delay):
    safety, X0 = npred.SafetyFilter(delay=delay), np.array([0.3, 0.9])
    loop = npred.simulate(
        CART, RK4(CART, 31), D=0.3, D_hat=0.3, X0=X0, t_end=3.0, dt=0.01, u0=[0.0], actuator="history", safety=safety
    )
    controller = npred.controller(
        CART, RK4(CART, 31), None, 0.01, D_hat=0.3, u0=[0.0], actuator="history", safety=safety, outlier_limit=None
    )
    changed, kept = [], []
    for X, U in zip(loop.X, loop.U, strict=True):
        np.testing.assert_allclose(controller.step(X), U, rtol=1e-8, atol=1e-8)
        changed.append(controller.status.filtered)
        kept.append(controller.status.kept)
    assert (changed == loop.filtered).all() and any(changed)
    assert not controller.status.unkept
    if delay == 0:  # what is said of the predicted state is true of the state at the moment when U acts
        np.testing.assert_allclose(kept[:-30], loop.safety[30:].min(axis=1), atol=3e-4)  # of 31 nodes


def test_a_saved_state_has_the_plan():
    made = lambda: npred.controller(
        CART, RK4(CART, 31), None, 0.01, D_hat=0.3, u0=[0.0], actuator="history", safety=npred.SafetyFilter()
    )
    first, second = made(), made()
    for k in range(30):
        first.step([0.3 + 0.009 * k, 0.9])
    assert first.status.filtered
    second.restore(first.state())
    assert second.step([0.6, 0.9]) == first.step([0.6, 0.9])


@pytest.mark.parametrize(
    "kappa",
    [
        lambda x, t, p, M: [-M.sign(x.x + x.v)],
        lambda x, t, p, M: [M.where(x.x + x.v > 0, -1.0, M.where(x.x + x.v < 0, 1.0, 0.0))],
        lambda x, t, p, M: [0.0],
    ],
    ids=["sign", "where", "none"],
)
def test_a_law_without_slopes_is_filtered_as_any_other(kappa):
    """A mass has no rate of its own: that of the loop is its law's over the whole box."""
    plant = Plant("relay", type("Relay", (Cart,), {"kappa": kappa, "safe": lambda x, t, p, M: [0.8 - x.x, 0.8 + x.x]}))
    X0 = from_box(plant, 60) * 0.7
    free, loop, first = (
        loops(plant, X0, safety, 0.1, t_end, 0.01)
        for safety, t_end in ((None, 6.0), (npred.SafetyFilter(), 6.0), (npred.SafetyFilter(), 0.01))
    )
    broken = free.safety[:, 11:].min(axis=(1, 2)) < 0
    kept, promised = loop.safety[:, 11:].min(axis=(1, 2)) >= 0, first.unkept == 0
    assert promised.sum() > 50 and kept[promised].all() and (broken & kept).any()


class Free(Cart):
    safe = None


def test_plants_and_controllers_that_it_does_not_serve_are_refused():
    plant = Plant("other", Free)
    with pytest.raises(ConfigError, match=r"expected a plant with safe\(x, t, p, M\)"):
        loops(plant, [0, 0], npred.SafetyFilter(), 0.3, 1.0)
    with pytest.raises(ConfigError, match='safety: expected actuator="history"'):
        npred.controller(CART, RK4(CART, 31), None, 0.01, D_hat=0.3, safety=npred.SafetyFilter(), actuator="measured")


@pytest.mark.parametrize(
    "named", [{"alpha": 0.0}, {"alpha": np.nan}, {"margin": -1.0}, {"delay": -0.1}, {"horizon": 0}]
)
def test_numbers_that_make_no_sense_are_refused(named):
    with pytest.raises(ConfigError, match=f"safety: expected {next(iter(named))}"):
        npred.SafetyFilter(**named)


def test_limits_are_kept_on_a_real_clock():
    """Calls 30 % early or late, with the interval of the delay that they need."""
    X0 = from_box(CART, 20) * 0.6
    named = {"D": 0.3, "D_hat": 0.3, "X0": X0, "t_end": 6.0, "dt": 0.01, "u0": [0.0], "actuator": "history"}
    safety, timing = npred.SafetyFilter(delay=0.01), npred.Timing(jitter=0.3)
    loop = npred.simulate(CART, RK4(CART, 31), safety=safety, timing=timing, **named)
    assert loop.safety.min() > 0 and loop.filtered.any()


class Shutter(Cart):
    """The end of the track comes and goes."""

    safe = lambda x, t, p, M: [1.0 + 0.2 * M.sin(2 * t) - x.x, 1.0 + x.x]


SHUTTER = Plant("shutter", Shutter)


def pushed(plant, push, D, delay, **named):
    """A controller whose observer finds an offset, and the mass after commands, by its parabolas."""
    dt = 0.01
    controller = npred.controller(
        plant, RK4(plant, 31), None, dt, D_hat=D, u0=[0.0], actuator="history", outlier_limit=None,
        safety=npred.SafetyFilter(delay=delay), observer=npred.observers.EKF(plant, offset=1.0, R=1e-8), **named,
    )  # fmt: skip

    def flown(X, U):
        for u in U:
            X = np.array([X[0] + dt * X[1] + dt**2 / 2 * (u + push), X[1] + dt * (u + push)])
        return X

    return controller, flown


@pytest.mark.parametrize(("push", "lates"), [(1.0, (26, 30, 34)), (-1.0, (26, 30, 34)), (0.5, (0, 2, 7))])
def test_an_offset_that_the_observer_found_acts_in_every_state_that_the_delay_may_lead_to(push, lates):
    """`kept` is the least h after the commands of the shortest, expected and longest delay, at the time then. No delay
    is below 0.
    """
    sent, X, late = [0.0] * 40, np.zeros(2), lates[1]
    controller, flown = pushed(SHUTTER, push, late / 100, (lates[2] - late) / 100)
    for k in range(400):
        ends = [(k + j, flown(X, sent[len(sent) - j :])[0]) for j in lates]
        least = min(min(1 + 0.2 * np.sin(0.02 * step) - x, 1 + x) for step, x in ends)
        U = controller.step(X)[0]
        if k >= 300:
            assert controller.status.kept == pytest.approx(least, abs=1e-4)
        sent.append(U)
        X = flown(X, [sent[-1 - late]])
    assert controller.status.offset[0] == pytest.approx(push, abs=1e-4)


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_an_offset_takes_from_the_room_of_u(push):
    """Near the end of the track, at a speed from which 4.5 of braking is needed: the push leaves 4 of 5."""
    controller, _ = pushed(CART, push, 0.1, 0.0)
    state = controller.state()
    state["filter"][2] = push
    controller.restore(state)
    x, v = np.array([0.9, 0.9]) * push
    U = controller.step([x - 0.1 * v + 0.1**2 / 2 * push, v - 0.1 * push])  # the commands before, 0, lead there
    np.testing.assert_allclose(controller.P[-1], [x, v], atol=1e-6)
    assert U.tolist() == [-5 * push] and controller.status.unkept
