"""The safety filter: the nearest U by a solver of SciPy, the chain of derivatives by hand, limits kept in loops."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

import npred
from npred.base.errors import ConfigError
from npred.exports import fmu
from npred.loop.safety.filter import assumed
from npred.plants import Plant
from npred.prediction.methods import RK4


class Cart:
    """A mass on a track of 1 m to either side, sent to 0.05 m before its end."""

    states, inputs = ("x", "v"), ("u",)
    box, input_bounds = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}, ((-5.0, 5.0),)
    f = lambda x, u, t, p, M: [x.v, u.u]
    kappa = lambda x, t, p, M: [-4 * (x.x - 0.95) - 1.2 * x.v]
    safe = lambda x, t, p, M: [1.0 - x.x, 1.0 + x.x]


class Plane:
    """A point in the plane that each input moves, and the other one a little; a wall that moves, and a circle."""

    states, inputs = ("x", "y"), ("u", "v")
    box, input_bounds = {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}, ((-1.0, 2.0), (-3.0, 1.0))
    f = lambda x, u, t, p, M: [0.3 * x.y + u.u, -0.2 * x.x + u.v + 0.4 * u.u]
    kappa = lambda x, t, p, M: [M.sin(3 * x.y) - x.x, M.cos(2 * x.x) - x.y]
    safe = lambda x, t, p, M: [1.0 + 0.2 * M.sin(t) - x.x, x.x * x.x + x.y * x.y - 0.25, 1.5 - x.y]


CART, PLANE = Plant("cart", Cart), Plant("plane", Plane)


def filtered(plant, safety, P, U, t, dt=0.01):
    """U (B, m), the least h, where U was changed and where in vain, of states P (B, n) at the times t when U acts."""
    B, bounds = len(P), np.array(plant.input_bounds)
    lanes = [np.array(a.T, order="C") for a in (P, U)]
    ends, low, high = lanes[0][None].copy(), *(np.repeat(bounds[:, [k]], B, axis=1) for k in (0, 1))
    kept, changed, unkept = np.empty((3, B))
    numbers = safety.settings(dt, bounds)["safety"]
    safety.kernel(plant)(ends, np.full((1, B), t), plant.p, numbers, low, high, lanes[1], kept, changed, unkept)
    return lanes[1].T, kept, changed, unkept


class Valve:
    """A flow that the valve scales: where nothing flows, no input moves the limit."""

    states, inputs = ("q",), ("u",)
    box, input_bounds = {"q": (0.0, 2.0)}, ((-1.0, 1.0),)
    f = lambda x, u, t, p, M: [x.q * u.u]
    kappa = lambda x, t, p, M: [0.5 - x.q]
    safe = lambda x, t, p, M: [x.q - 0.2]


def test_a_limit_that_no_input_moves_is_unkept_and_changes_nothing():
    valve = Plant("valve", Valve)
    P, U = np.array([[0.0], [0.0], [0.05], [1.0]]), np.array([[0.5], [-0.7], [1.0], [0.5]])
    after, kept, changed, unkept = filtered(valve, npred.SafetyFilter(), P, U, 0.0)
    assert np.array_equal(after, U) and np.allclose(kept, P[:, 0] - 0.2)
    assert unkept.tolist() == [1, 1, 1, 0]  # at rest; and at the bound, where U is all that the valve can do
    assert not changed.any()
    rk4 = npred.predictor("rk4", valve, nx=11)
    for actuator in ("measured", "history"):
        loop = npred.simulate(
            valve, rk4, D=0.2, D_hat=0.2, X0=[0.0], t_end=1.0, dt=0.01, safety=npred.SafetyFilter(), actuator=actuator
        )
        assert loop.changes == 0 and not loop.filtered.any() and loop.unkept == loop.steps


def rate_of_plane(x, U):
    return np.array([0.3 * x[1] + U[0], -0.2 * x[0] + U[1] + 0.4 * U[0]])


def conditions_of_plane(x, U, t, alpha):
    """φ of the three limits at one state, by hand."""
    h = np.array([1 + 0.2 * np.sin(t) - x[0], x @ x - 0.25, 1.5 - x[1]])
    slope = np.array([[-1.0, 0.0], 2 * x, [0.0, -1.0]])
    return slope @ rate_of_plane(x, U) + np.array([0.2 * np.cos(t), 0.0, 0.0]) + alpha * h, h


def at_both_ends(x, U, t, alpha, dt):
    """φ at the begin of a control step and after a step of Heun's method with U."""
    rate = rate_of_plane(x, U)
    end = x + dt / 2 * (rate + rate_of_plane(x + dt * rate, U))
    return np.concatenate([conditions_of_plane(x, U, t, alpha)[0], conditions_of_plane(end, U, t + dt, alpha)[0]])


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 5.0))
@settings(max_examples=100, deadline=None)
def test_u_is_the_nearest_that_scipy_finds(seed, alpha):
    rng = np.random.default_rng(seed)
    x, U, t, dt = rng.uniform(-1.5, 1.5, 2), rng.uniform([-1, -3], [2, 1]), rng.uniform(0, 6), 0.01
    found, kept, changed, unkept = (v[0] for v in filtered(PLANE, npred.SafetyFilter(alpha), x[None], U[None], t))
    assert kept == pytest.approx(conditions_of_plane(x, U, t, alpha)[1].min(), abs=1e-12)
    widths = np.array([3.0, 4.0])
    if (at_both_ends(x, U, t, alpha, dt) >= 0).all():
        assert not changed and not unkept and (found == U).all()
        return
    constraint = {"type": "ineq", "fun": lambda u: at_both_ends(x, u, t, alpha, dt)}
    by_scipy = minimize(
        lambda u: (((u - U) / widths) ** 2).sum(), U, jac=lambda u: 2 * (u - U) / widths**2, method="SLSQP",
        bounds=PLANE.input_bounds, constraints=constraint, options={"ftol": 1e-15},
    )  # fmt: skip
    if changed and not unkept:
        assert (at_both_ends(x, found, t, alpha, dt) > -1e-5).all()
        if by_scipy.success:
            np.testing.assert_allclose(found, by_scipy.x, atol=4.0 * dt**2)  # slopes at the end are to first order
    else:
        assert not by_scipy.success or (at_both_ends(x, by_scipy.x, t, alpha, dt) < 1e-5).any()


def test_a_law_beyond_the_bounds_of_u_keeps_no_limit_by_what_is_not_sent():
    """v = 5 would keep the point out of the circle, and 1 is all there is: u, which moves y by 0.4, does the rest."""
    x, t, alpha, dt = np.array([0.0, 0.3]), 0.0, 5.0, 0.01
    found, _, changed, unkept = filtered(PLANE, npred.SafetyFilter(alpha), x[None], np.array([[0.0, 5.0]]), t, dt)
    assert changed[0] and not unkept[0] and found[0] == pytest.approx([5 / 6, 1.0], abs=1e-3)
    assert at_both_ends(x, found[0], t, alpha, dt).min() == pytest.approx(0.0, abs=1e-5)


def test_what_is_sent_keeps_the_limits_or_it_is_said():
    """Of laws within the bounds and far beyond them; and where the law's U, at its bounds, keeps them, it is left."""
    rng, (low, high), alpha, dt = np.random.default_rng(0), np.array(PLANE.input_bounds).T, 2.0, 0.01
    P, U = rng.uniform(-1.5, 1.5, (2000, 2)), rng.uniform(3 * low - 1, 3 * high + 1, (2000, 2))
    found, _, changed, unkept = filtered(PLANE, npred.SafetyFilter(alpha), P, U, 0.7, dt)
    sent, free = (
        np.array([at_both_ends(x, u, 0.7, alpha, dt).min() for x, u in zip(P, np.clip(V, low, high), strict=True)])
        for V in (found, U)
    )
    assert (sent[unkept == 0] > -1e-5).all() and (sent[unkept > 0] < 0).all() and 5 < unkept.sum() < 500
    assert (changed[free >= 0] == 0).all() and (found[free >= 0] == U[free >= 0]).all() and (free >= 0).sum() > 200


def test_the_chain_of_a_limit_that_the_second_derivative_reaches():
    """h = 1 - x of a mass: h'' + 2 α h' + α² h >= 0 at the begin of a step and at its end; by hand."""
    alpha, dt, rng = 3.0, 0.01, np.random.default_rng(0)
    P, U = rng.uniform(-1, 1, (200, 2)), rng.uniform(-5, 5, (200, 1))
    x, v, u = P[:, 0], P[:, 1], U[:, 0]
    most = 1 + 2 * alpha * dt + (alpha * dt) ** 2 / 2  # how much U moves the condition at the end
    at_end = 2 * alpha * v + alpha**2 * (x + v * dt)
    upper = np.minimum(-2 * alpha * v + alpha**2 * (1 - x), (alpha**2 - at_end) / most)
    lower = np.maximum(-2 * alpha * v - alpha**2 * (1 + x), (-(alpha**2) - at_end) / most)
    expected = np.clip(np.clip(u, lower, upper), -5, 5)
    found, _, changed, unkept = filtered(CART, npred.SafetyFilter(alpha), P, U, 0.0)
    room = lower < upper
    np.testing.assert_allclose(found[room, 0], expected[room], atol=1e-6)
    wanting = (lower > 5) | (upper < -5)
    assert (changed[room] == (np.abs(expected - u) > 0)[room]).all() and (unkept[room] == wanting[room]).all()


class Tilted(Cart):
    parameters = {"tilt": 0.0}
    safe = lambda x, t, p, M: [1.0 - x.x - p.tilt * x.v, 1.0 + x.x + (x.v - x.v)]


def test_the_relative_degree_is_that_of_the_values_on_the_box():
    """On the tape U enters the first derivative of both limits, by numbers that are 0: the loops are those without."""
    named = {"D": 0.3, "D_hat": 0.3, "X0": [-0.6, 0.2], "t_end": 8.0, "dt": 0.01, "u0": [0.0], "actuator": "history"}
    plain, tilted = (
        npred.simulate(plant, RK4(plant, 31), safety=npred.SafetyFilter(3.0), **named)
        for plant in (CART, Plant("tilted", Tilted))
    )
    assert plain.filtered.any() and not tilted.unkept
    np.testing.assert_allclose(tilted.U, plain.U, atol=1e-12)
    assert assumed(Plant("tilted", Tilted)) == ["tilt"] and not assumed(CART)


@pytest.mark.parametrize(("tilt", "about"), [(0.0, "; the safety filter is written for 0"), (0.5, "")])
def test_an_fmu_says_which_parameter_decided_the_relative_degree(tilt, about):
    plant = Plant("tilted", Tilted, {"tilt": tilt})
    controller = npred.controller(plant, RK4(plant, 11), None, 0.01, D_hat=0.3, actuator="history", u0=[0.0],
                                  safety=npred.SafetyFilter(3.0))  # fmt: skip
    (parameter,) = [a for a in fmu.variables(controller, np.zeros(2), False) if a.name == "parameter.tilt"]
    assert parameter.about == "parameter of plant and law" + about


def test_a_parameter_that_is_not_0_lets_u_act_on_the_first_derivative():
    """h = 1 - x - v / 2: h' + α h >= 0 bounds U from above by itself, at the begin of a step."""
    leaning, alpha, rng = Plant("tilted", Tilted, {"tilt": 0.5}), 1.0, np.random.default_rng(0)
    P, U = rng.uniform(-0.6, 0.6, (400, 2)), rng.uniform(-5, 5, (400, 1))
    upper = 2 * (alpha * (1 - P[:, 0] - P[:, 1] / 2) - P[:, 1])
    found = filtered(leaning, npred.SafetyFilter(alpha), P, U, 0.0, dt=1e-5)[0][:, 0]
    active = (upper < U[:, 0]) & (upper > -5)
    assert active.sum() > 20 and not assumed(leaning)
    np.testing.assert_allclose(found[active], upper[active], atol=1e-3)


def test_at_the_end_of_the_track_u_does_not_point_outward():
    """h = h' = 0: U is 0, but for rounding. Before, 5e-10 of what was asked for was left."""
    U = np.array([[0.01], [0.3], [1.0], [1.5], [5.0]])
    for end in (1.0, -1.0):
        P = np.tile([end, 0.0], (len(U), 1))
        found, _, changed, unkept = filtered(CART, npred.SafetyFilter(1.0), P, end * U, 0.0)
        assert changed.all() and not unkept.any() and np.abs(found).max() < 1e-14


def test_conditions_hold_to_second_order_while_u_is_held():
    """How far φ is below 0 at the end of a step, by SciPy: it falls with the third power of the step; within, too."""
    alpha, rng, steps = 2.0, np.random.default_rng(3), np.array([0.08, 0.04, 0.02, 0.01])
    P, U = rng.uniform(-1.2, 1.2, (150, 2)), rng.uniform([-1, -3], [2, 1], (150, 2))
    answers = [filtered(PLANE, npred.SafetyFilter(alpha), P, U, 0.7, dt) for dt in steps]
    both = np.all([changed > unkept for _, _, changed, unkept in answers], axis=0)
    ends = []
    for dt, (found, *_) in zip(steps, answers, strict=True):
        times, least = np.linspace(0, dt, 5), np.zeros(5)
        for x, u in zip(P[both], found[both], strict=True):
            path = solve_ivp(lambda t, x, u=u: rate_of_plane(x, u), (0, dt), x, "DOP853", times, rtol=1e-12, atol=1e-14)
            phi = [conditions_of_plane(y, u, 0.7 + t, alpha)[0].min() for t, y in zip(times, path.y.T, strict=True)]
            least = np.minimum(least, phi)
        assert least[0] > -1e-13 and least.min() > -(dt**2)
        ends.append(-least[-1])
    assert both.sum() > 30 and ends[0] > 1e-7 and (ends < 0.01 * steps**3).all()


def test_conditions_are_of_second_order_in_the_step_where_time_moves_the_plant():
    """x' = u + 2 sin 6t towards a wall that moves: φ at the end of a step in closed form, three steps of dt."""

    class Shaken:
        states, inputs, box, input_bounds = ("x",), ("u",), {"x": (-1.0, 1.0)}, ((-9.0, 9.0),)
        f = lambda x, u, t, p, M: [u.u + 2 * M.sin(6 * t)]
        kappa = lambda x, t, p, M: [0 * x.x]
        safe = lambda x, t, p, M: [1.0 + 0.3 * M.sin(4 * t) - x.x]

    plant, alpha, steps = Plant("shaken", Shaken), 2.0, np.array([0.08, 0.04, 0.02, 0.01])
    x, t0, ends = np.linspace(0.2, 1.0, 40), 0.35, []
    for dt in steps:
        u, _, changed, unkept = filtered(plant, npred.SafetyFilter(alpha), x[:, None], np.full((40, 1), 5.0), t0, dt)

        def phi(t, there, u=u[:, 0]):
            return 1.2 * np.cos(4 * t) - u - 2 * np.sin(6 * t) + alpha * (1 + 0.3 * np.sin(4 * t) - there)

        end = phi(t0 + dt, x + u[:, 0] * dt + (np.cos(6 * t0) - np.cos(6 * (t0 + dt))) / 3)
        assert changed.all() and not unkept.any() and phi(t0, x).min() > -1e-6
        ends.append(np.abs(np.minimum(end, 0)).max())
    assert np.polyfit(np.log(steps), np.log(ends), 1)[0] > 2.7


def safe_starts(count, alpha=3.0, D=0.3):
    """Starts whose states at the moment when the first input acts are in the set that the filter keeps."""
    X0 = np.random.default_rng(1).uniform([-0.8, -0.5], [0.8, 0.5], (count, 2))
    x, v = X0[:, 0] + D * X0[:, 1], X0[:, 1]
    return X0[(alpha * (1 - x) - v >= 0) & (alpha * (1 + x) + v >= 0)]


@pytest.mark.parametrize(("D", "delay"), [(0.3, 0.0), (0.28, 0.02), (0.32, 0.02)])
def test_limits_are_kept_in_loops_and_would_not_be_without(D, delay):
    safety = npred.SafetyFilter(3.0, delay=delay)
    X0 = safe_starts(300)
    named = {"D": D, "D_hat": 0.3, "X0": X0, "t_end": 8.0, "dt": 0.01, "u0": [0.0], "actuator": "history"}
    free = npred.simulate(CART, RK4(CART, 31), **named)
    loop = npred.simulate(CART, RK4(CART, 31), safety=safety, **named)
    assert free.safety.min() < -0.3 and not free.filtered.any()
    assert loop.safety.min() > 0 and loop.unkept.sum() == 0 and 0 < loop.filtered.mean() < 0.5
    assert np.abs(loop.X[:, -1, 0] - 0.95).max() < 0.02


def test_a_filter_that_never_acts_changes_nothing():
    named = {"D": 0.3, "D_hat": 0.3, "X0": [[0.9, 0.0]], "t_end": 3.0, "dt": 0.01, "u0": [0.2]}
    free, loop = (npred.simulate(CART, RK4(CART, 31), safety=s, **named) for s in (None, npred.SafetyFilter(20.0)))
    assert not loop.filtered.any() and (loop.U == free.U).all()


@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_a_controller_filters_as_the_simulated_loop(delay):
    safety, X0 = npred.SafetyFilter(3.0, delay=delay), np.array([0.3, 0.45])
    loop = npred.simulate(
        CART, RK4(CART, 31), D=0.3, D_hat=0.3, X0=X0, t_end=3.0, dt=0.01, u0=[0.0], actuator="history", safety=safety
    )
    controller = npred.controller(
        CART, RK4(CART, 31), None, 0.01, D_hat=0.3, u0=[0.0], actuator="history", safety=safety, outlier_limit=None
    )
    changed, kept = [], []
    for X, U in zip(loop.X, loop.U, strict=True):
        np.testing.assert_allclose(controller.step(X), U, rtol=1e-12, atol=1e-12)
        changed.append(controller.status.filtered)
        kept.append(controller.status.kept)
    assert (changed == loop.filtered).all() and any(changed)
    assert not controller.status.unkept
    if delay == 0:  # what is said of the predicted state is true of the state at the moment when U acts
        np.testing.assert_allclose(kept[:-30], loop.safety[30:].min(axis=1), atol=3e-4)  # of 31 nodes


class Bent(Cart):
    f = lambda x, u, t, p, M: [x.v, u.u + u.u * u.u * u.u]


class Still(Cart):
    safe = lambda x, t, p, M: [1.0]


class Free(Cart):
    safe = None


@pytest.mark.parametrize(("kind", "message"), [
    (Bent, "limits whose derivative is linear in the input, that of number 0 is not"),
    (Still, "limits that the input moves, it does not move number 0"),
    (Free, r"expected a plant with safe\(x, t, p, M\)"),
])  # fmt: skip
def test_plants_that_it_does_not_serve_are_refused(kind, message):
    plant = Plant("other", kind)
    with pytest.raises(ConfigError, match=message):
        npred.simulate(plant, RK4(plant, 21), D=0.3, D_hat=0.3, X0=[0, 0], t_end=1.0, safety=npred.SafetyFilter())


@pytest.mark.parametrize("named", [{"alpha": 0.0}, {"alpha": np.nan}, {"margin": -1.0}, {"delay": -0.1}])
def test_numbers_that_make_no_sense_are_refused(named):
    with pytest.raises(ConfigError, match=f"safety: expected {next(iter(named))}"):
        npred.SafetyFilter(**named)
    with pytest.raises(ConfigError, match="expected alpha up to 1 / dt"):
        npred.simulate(CART, RK4(CART, 21), D=0.3, D_hat=0.3, X0=[0, 0], t_end=1, dt=0.1, safety=npred.SafetyFilter(11))


def test_limits_are_kept_on_a_real_clock():
    """Calls 30 % early or late, with the interval of the delay that they need."""
    X0 = safe_starts(20)
    named = {"D": 0.3, "D_hat": 0.3, "X0": X0, "t_end": 6.0, "dt": 0.01, "u0": [0.0], "actuator": "history"}
    safety, timing = npred.SafetyFilter(3.0, delay=0.01), npred.Timing(jitter=0.3)
    loop = npred.simulate(CART, RK4(CART, 31), safety=safety, timing=timing, **named)
    assert loop.safety.min() > 0 and loop.filtered.any() and not loop.unkept.any()


class Shutter(Cart):
    """The end of the track comes and goes."""

    safe = lambda x, t, p, M: [1.0 + 0.2 * M.sin(2 * t) - x.x, 1.0 + x.x]


SHUTTER = Plant("shutter", Shutter)


def pushed(plant, push, D, delay, **named):
    """A controller whose observer finds an offset, and the mass after commands, by its parabolas."""
    dt = 0.01
    controller = npred.controller(
        plant, RK4(plant, 31), None, dt, D_hat=D, u0=[0.0], actuator="history", outlier_limit=None,
        safety=npred.SafetyFilter(3.0, delay=delay), observer=npred.observers.EKF(plant, offset=1.0, R=1e-8), **named,
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


def test_a_margin_is_kept_on_top_of_the_limits():
    """φ >= margin at both ends of a step, in a unit of h over a second."""
    rng, alpha, dt = np.random.default_rng(4), 2.0, 0.01
    P, U = rng.uniform(-1.2, 1.2, (200, 2)), rng.uniform([-1, -3], [2, 1], (200, 2))
    found, _, changed, unkept = filtered(PLANE, npred.SafetyFilter(alpha, margin=0.3), P, U, 0.7)
    phi = np.array([at_both_ends(x, u, 0.7, alpha, dt).min() for x, u in zip(P, found, strict=True)])
    free = np.array([at_both_ends(x, u, 0.7, alpha, dt).min() for x, u in zip(P, U, strict=True)])
    kept = changed > unkept
    assert kept.sum() > 30 and np.abs(phi[kept] - 0.3).max() < 1e-4
    assert (free[changed == 0] >= 0.3).all() and (phi[unkept > 0] < 0.3).all() and unkept.any()
