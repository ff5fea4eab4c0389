"""Loops on a real clock: the schedule, and each loop against an event loop in Python with the plant by SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import npred
from npred.base.errors import ConfigError
from npred.loop.timing import schedule, uniform
from npred.plants import Plant
from npred.prediction.methods import RK4

DT = 0.01


class Swing:
    """A pendulum's angle and rate, upright, driven by its torque."""

    states, inputs = ("angle", "rate"), ("torque",)
    box = {"angle": (-3.0, 3.0), "rate": (-5.0, 5.0)}
    f = lambda x, u, t, p, M: [x.rate, M.sin(x.angle) - 0.5 * x.rate + u.torque]
    kappa = lambda x, t, p, M: [-M.sin(x.angle) - 2 * x.angle - 2 * x.rate]
    V = lambda x, t, p, M: x.angle**2 + x.rate**2


class Seen(Swing):
    """Of which the tilt is measured."""

    outputs = ("tilt",)
    output = lambda x, t, p, M: [M.sin(x.angle) + 0.1 * M.sin(t)]


class Rocked(Seen):
    """On a ship."""

    f = lambda x, u, t, p, M: [x.rate, M.sin(x.angle) - 0.5 * x.rate + u.torque + 2 * M.cos(9 * t)]


class Pair:
    """Two integrators, the second input later by half."""

    states, inputs, delays = ("a", "b"), ("u", "v"), (0.5, 1.0)
    box = {"a": (-2.0, 2.0), "b": (-2.0, 2.0)}
    f = lambda x, u, t, p, M: [u.u + 0.3 * x.b, u.v]
    kappa = lambda x, t, p, M: [-x.a, -x.b]
    V = lambda x, t, p, M: x.a**2 + x.b**2


SWING, SEEN, PAIR, ROCKED = (Plant(kind.__name__.lower(), kind) for kind in (Swing, Seen, Pair, Rocked))
TIMED = {"timing": npred.Timing(), "outlier_limit": None}
UNSTEADY = npred.Timing(jitter=0.3, lost=0.1, overrun=0.1, seed=3)


def simulated(plant, X0, t_end=3.0, D=0.2, D_hat=None, **named):
    return npred.simulate(
        plant, RK4(plant, 41), D=D, D_hat=0.2 if D_hat is None else D_hat, X0=X0, t_end=t_end, dt=DT,
        actuator="history", **named,
    )  # fmt: skip


def truth(plant, sent, delay, push, X, start, end):
    """The state at `end` by SciPy: between two switches all inputs are held."""
    ratios = plant.ratios

    def acting(t):
        return [
            next((U[c] for s, U in reversed(sent) if s <= t - ratios[c] * delay(t) + 1e-12), sent[0][1][c])
            for c in range(plant.m)
        ]

    cuts = {start, end}
    for s, _ in sent[-60:]:
        for r in ratios:
            low, high = start, end
            if low - r * delay(low) < s < high - r * delay(high):
                for _ in range(60):
                    middle = (low + high) / 2
                    low, high = (middle, high) if middle - r * delay(middle) < s else (low, middle)
                cuts.add(high)
    cuts = sorted(cuts)
    for a, b in zip(cuts[:-1], cuts[1:], strict=True):
        U = acting(0.5 * (a + b))

        def f(t, x, U=U):
            return plant.f(x, np.array(U) + push(t), t)

        X = solve_ivp(f, (a, b), X, rtol=1e-11, atol=1e-13, max_step=0.01).y[:, -1]
    return X


def referee(plant, X0, t_end, plan, timing, D=0.2, law=None, D_hat=0.2, push=lambda t: 0.0, **named):
    """X at the control steps, and U, D_hat and X_hat of each, by an event loop in Python."""
    delay = D if callable(D) else lambda t: D
    controller = npred.controller(plant, RK4(plant, 41), law, DT, D_hat=D_hat, actuator="history", **named)
    sent, X, at, untold = [(-np.inf, np.zeros(plant.m))], np.array(X0), 0.0, None
    samples, waiting, rows, U = {}, list(zip(plan.taken, plan.number, strict=True)), [], np.zeros(plant.m)
    events = [(k * DT, 2, "row", k) for k in range(round(t_end / DT) + 1)]
    events += [(p * DT, 0, "sample", j) for j, (p, _) in enumerate(waiting)]
    events += [(p * DT, 1, "call", k) for k, p in enumerate(plan.at) if not plan.skipped[k]]
    log = {}
    for t, _, what, k in sorted(events):
        X = truth(plant, sent, delay, push, X, at, t) if t > at else X
        at = max(t, at)
        if what == "sample":
            samples[k] = plant.output(X, t) if named.get("observer") else X.copy()
        elif what == "row":
            rows.append(X.copy())
        else:
            j = plan.sample[k]
            Y = None if j < 0 else samples[j]
            U = controller.step(
                Y, t=t, sampled_at=None if Y is None else t - plan.age[k] * DT,
                applied=sent[-1][1] if untold and timing.tells else None,
            ).copy()  # fmt: skip
            untold = plan.lost[k]
            if not plan.lost[k]:
                sent.append((t, U))
            log[k] = U, controller.D_hat, controller.X_hat
    kept = sorted(log)
    return np.array(rows), kept, [np.array([log[k][i] for k in kept]) for i in range(3)]


def drift(t):
    """A delay that is linear over each control step."""
    times = DT * np.arange(1000)
    return float(np.interp(t, times, 0.2 + 0.05 * np.sin(2 * times)))


CASES = {
    "late samples": (SWING, UNSTEADY, npred.Measurement(period=0.017, jitter=0.4, delay=0.043, drop=0.2), {}),
    "told": (SWING, npred.Timing(jitter=0.4, lost=0.3, tells=True), npred.Measurement(delay=0.03), {}),
    "drift": (SWING, UNSTEADY, npred.Measurement(), {"D": drift}),
    "watchdog": (SWING, npred.Timing(jitter=0.2), npred.Measurement(period=0.06, jitter=0.9),
                 {"watchdog": npred.Watchdog(0.05, "zero", jump=0.3)}),
    "delays": (PAIR, UNSTEADY, npred.Measurement(period=0.02), {}),
    "observer": (SEEN, UNSTEADY, npred.Measurement(delay=0.02), {"observer": npred.observers.EKF(SEEN)}),
    "plant of time": (ROCKED, UNSTEADY, npred.Measurement(delay=0.02), {"observer": npred.observers.EKF(ROCKED)}),
    "delay observer": (SWING, UNSTEADY, npred.Measurement(drop=0.2),
                       {"law": npred.DelayObserver(bounds=(0.05, 0.4)), "D_hat": 0.3}),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_loop_is_that_of_the_event_loop_in_python(name):
    """A piece of the plant is a step of RK4 here, and SciPy's there."""
    plant, timing, measurement, named = CASES[name]
    X0, t_end = [0.5, 0.2], 1.5
    law = named.get("law")
    passed = {key: value for key, value in named.items() if key != "law"}
    run = simulated(plant, X0, t_end, timing=timing, measurement=measurement, adaptation=law, **passed)
    plan = schedule(timing, measurement, DT, round(t_end / DT) + 1, 0)
    X, kept, (U, D_hat, X_hat) = referee(plant, X0, t_end, plan, timing, **named)
    close = {"atol": 1e-7, "rtol": 0}
    np.testing.assert_allclose(run.X, X, **close)
    np.testing.assert_allclose(run.U[kept], U, rtol=0, atol=1e-6)
    np.testing.assert_allclose(run.clock.X_hat[kept], X_hat, **close)
    if law:
        np.testing.assert_allclose(run.D_hat[kept], D_hat, atol=1e-6)
        assert abs(D_hat[-1] - 0.2) < 0.02
    assert run.clock.skipped == plan.skipped.sum() and run.clock.lost == (plan.lost & ~plan.skipped).sum()
    if name == "watchdog":
        handed = run.clock.handed_over
        assert 10 < handed.sum() < 140
        assert np.abs(np.diff(run.U[:, 0]))[handed[1:]].max() <= 0.3 + 1e-12


@pytest.mark.parametrize("D", [0.2, 0.2345])
@pytest.mark.parametrize("law", [None, npred.DelayObserver(bounds=(0.05, 0.4)), npred.DelayAdaptation(gamma=0.01)])
def test_ideal_timing_is_the_plain_loop(D, law):
    """Up to rounding errors: positions in the history are counted from another step."""
    named = {"X0": np.array([[0.5, 0.2], [-0.3, 0.1], [0.1, 0.0]]), "D_hat": 0.25, "adaptation": law, "u0": "law"}
    plain = simulated(SWING, D=D, **named)
    timed = simulated(SWING, D=D, timing=npred.Timing(), outlier_limit=None, **named)
    for series in ("X", "U", "P", "D_hat", "N"):
        np.testing.assert_allclose(getattr(timed, series), getattr(plain, series), rtol=0, atol=1e-10)
    assert not timed.clock.age.any() and not timed.clock.skipped.any() and not timed.clock.refusals.any()


def test_a_delay_that_jumps_is_the_plain_loops():
    """Where it grows, the plant gets older commands again. In the step of the jump itself the two differ a little."""
    for before, after in ((0.2, 0.3), (0.3, 0.2)):
        D = lambda t, a=before, b=after: a if t < 1.0 else b
        plain, timed = (
            simulated(SWING, [0.5, 0.2], D=D, **more)
            for more in ({}, {"timing": npred.Timing(), "outlier_limit": None})
        )
        np.testing.assert_allclose(timed.X, plain.X, rtol=0, atol=1e-5)


def test_a_disturbance_and_a_history_before_the_start_are_the_plain_loops():
    X0, push = [[0.5, 0.2], [0.2, 0.0]], lambda t: [[np.sin(3 * t)], [0.2]]
    for u0 in ([[0.3], [-0.2], [0.1]], lambda t: [np.cos(9 * t)]):
        plain, timed = (
            simulated(SWING, X0, u0=u0, disturbance=push, **more)
            for more in ({}, {"timing": npred.Timing(), "outlier_limit": None})
        )
        np.testing.assert_allclose(timed.X, plain.X, rtol=0, atol=1e-10)


def test_a_loop_does_not_depend_on_its_batch():
    X0 = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 2))
    sensors = {"relative_noise": 0.05, "noise": 0.01, "resolution": [0.01, 0.0], "delay": 0.03, "drop": 0.1, "seed": 2}
    run = simulated(SWING, X0, timing=UNSTEADY, measurement=npred.Measurement(**sensors))
    for l in range(5):
        alone = simulated(SWING, X0[l], timing=UNSTEADY, measurement=npred.Measurement(**sensors, first=l))
        assert (run.X[l] == alone.X).all() and (run.U[l] == alone.U).all()
    assert len({tuple(run.U[l, :, 0]) for l in range(5)}) == 5


def test_the_schedule_has_the_jitter_the_losses_and_the_ages_that_are_declared():
    timing = npred.Timing(jitter=0.3, lost=0.05, overrun=0.02, seed=7)
    sensors = npred.Measurement(period=0.013, jitter=0.2, delay=0.031, drop=0.1)
    plan = schedule(timing, sensors, DT, 20000, 4)
    offset = (plan.at - np.arange(20000))[1:]
    assert np.abs(offset).max() < 0.3 and offset.std() == pytest.approx(0.3 / np.sqrt(3), rel=0.02)
    assert plan.lost.mean() == pytest.approx(0.05, rel=0.1) and plan.skipped.mean() == pytest.approx(0.02, rel=0.2)
    gaps = np.diff(plan.taken)[np.diff(plan.number) == 1]
    assert gaps.min() > 1.3 * 0.8 and gaps.max() < 1.3 * 1.2 and gaps.mean() == pytest.approx(1.3, rel=0.01)
    assert np.mean(np.diff(plan.number) > 1) == pytest.approx(0.1, rel=0.1)
    for k in np.flatnonzero(~plan.skipped)[1:500]:
        arrived = np.flatnonzero(plan.taken * DT + 0.031 <= plan.at[k] * DT + 1e-12)
        newest = max(arrived, default=0)
        if plan.sample[k] >= 0:
            assert plan.sample[k] == newest and plan.age[k] == pytest.approx(plan.at[k] - plan.taken[newest])
        else:
            assert newest in plan.sample[:k] or newest == 0


def test_samples_stop_for_the_end_of_each_period_and_the_first_one_is_there_at_once():
    """None of 0.3 s in each second; with these, too, the loop begins with a sample and a call."""
    stops = schedule(npred.Timing(stop=0.3, stop_every=1.0), npred.Measurement(), DT, 250, 0)
    expected = np.arange(250) % 100 < 70
    assert (stops.sample >= 0).tolist() == expected.tolist() and not stops.age.any()
    for loop in range(40):
        timing, sensors = npred.Timing(overrun=0.5, lost=0.5, seed=1), npred.Measurement(drop=0.6, delay=0.05, seed=2)
        plan = schedule(timing, sensors, DT, 30, loop)
        assert not plan.skipped[0] and plan.sample[0] == 0 and plan.age[0] == 0.0 and plan.taken[0] == 0.0


@pytest.mark.parametrize(("dt", "every"), [(0.01, 0.1), (0.02, 0.6), (0.005, 0.035)])
def test_samples_stop_at_the_same_control_step_of_each_period(dt, every):
    stops = schedule(npred.Timing(stop=dt, stop_every=every), npred.Measurement(), dt, 2001, 0)
    steps = np.arange(2001)
    np.testing.assert_array_equal(np.setdiff1d(steps, stops.number), steps[(steps + 1) % round(every / dt) == 0])


@pytest.mark.parametrize(("period", "dt"), [(0.07, 0.01), (0.14, 0.02), (0.07, 0.005)])
def test_a_period_of_whole_control_steps_that_rounds_up_is_sampled(period, dt):
    plant = npred.plant("scalar")
    loop = npred.simulate(
        plant, npred.predictor(plant, "rk4", 11), D=0.1, D_hat=0.1, X0=[1.0], t_end=2.0, dt=dt, actuator="history",
        max_sample_age=5.0, progress=False, timing=npred.Timing(), measurement=npred.Measurement(period=period),
    )  # fmt: skip
    assert loop.clock.refusals.sum() == 0 and loop.clock.age.max() < period


def test_random_numbers_are_those_of_the_loop_in_c():
    """Samples of a plain loop are dropped where this function says so."""
    dropped = uniform(5, 2, np.arange(50), 3) < 0.4
    assert 10 < dropped.sum() < 30
    seen = []

    def observer(X_hat, Y, U, t):
        seen.append(np.isnan(Y[0, 0]))
        return np.where(np.isnan(Y), X_hat, Y)

    sensors = npred.Measurement(drop=0.4, seed=5, first=2, observer=observer)
    simulated(SWING, [0.1, 0.0], t_end=0.49, measurement=sensors)
    assert seen[1:] == dropped[1:].tolist()


def test_an_observer_in_the_loop_gets_outputs_with_errors_of_their_own():
    run = simulated(
        SEEN,
        [0.5, 0.0],
        t_end=4.0,
        observer=npred.observers.EKF(SEEN),
        measurement=npred.Measurement(resolution=[0.02]),
    )
    assert np.abs(run.X[-1]).max() < 0.1 and np.abs(run.clock.X_hat[-1] - run.X[-1]).max() < 0.05
    with pytest.raises(ConfigError, match="expected noise as one number or 1, one per output of plant seen, got 2"):
        simulated(SEEN, [0.5, 0.0], observer=npred.observers.EKF(SEEN), measurement=npred.Measurement([0.1, 0.1]))


def test_what_a_loop_on_a_clock_cannot_have_is_refused_in_one_line():
    timed = {"timing": npred.Timing()}
    start = {"D": 0.2, "D_hat": 0.2, "X0": [0.5, 0.0], "t_end": 1.0, "dt": DT}
    with pytest.raises(ConfigError, match='timing: expected actuator="history"'):
        npred.simulate(SWING, RK4(SWING, 11), **start, **timed)
    with pytest.raises(ConfigError, match="timing: expected a predictor, got None"):
        npred.simulate(SWING, None, **start, actuator="history", **timed)
    with pytest.raises(ConfigError, match=r"timing: expected an npred\.Timing"):
        simulated(SWING, [0.5, 0.0], timing=0.3)
    with pytest.raises(ConfigError, match="measurement: expected no observer in Python"):
        simulated(SWING, [0.5, 0.0], measurement=npred.Measurement(observer=lambda *_: 0), **timed)
    late = npred.plant("unicycle_time_delay")
    with pytest.raises(ConfigError, match="timing: expected a plant that does not declare its delay"):
        npred.simulate(late, RK4(late, 11), X0=[0.1, 0.1, 0.1], t_end=1.0, actuator="history", **timed)
    tank = npred.plant(type("Late", (Seen,), {"delay": lambda x, t, p, M: 0.2 + 0.1 * M.sin(t)}))
    start = {"X0": [0.1, 0.1], "t_end": 0.5, "dt": DT, "actuator": "history"}
    ekf = npred.observers.EKF(tank)
    with pytest.raises(ConfigError, match=r"^observer: expected a plant that does not declare its delay, got Late"):
        npred.simulate(tank, RK4(tank, 11), observer=ekf, **start)
    controller = npred.controller(tank, RK4(tank, 11), None, DT, observer=ekf, actuator="history")
    assert np.isfinite(controller.step([0.1])).all()
    in_python = npred.Measurement(observer=lambda X_hat, Y, U, t: np.where(np.isfinite(Y), Y, X_hat))
    assert np.isfinite(npred.simulate(tank, RK4(tank, 11), measurement=in_python, **start).X).all()
    for wrong in ({"jitter": 0.5}, {"lost": 1.0}, {"overrun": -0.1}, {"seed": 0.5}):
        with pytest.raises(ConfigError, match=f"timing: .*{next(iter(wrong))}"):
            npred.Timing(**wrong)


def test_a_plant_in_python_runs_through_the_same_loop():
    called = Plant("called", type("Called", (Swing,), {"traced": False}))
    runs = [simulated(p, [0.5, 0.2], 0.5, timing=UNSTEADY) for p in (SWING, called)]
    np.testing.assert_allclose(runs[0].X, runs[1].X, rtol=0, atol=1e-10)
