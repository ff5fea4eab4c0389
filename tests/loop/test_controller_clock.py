"""The controller on a real clock: calls at any time, samples that come late or not at all, commands not sent."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import npred
from npred.base.errors import ConfigError, DivergedError
from npred.loop.clock import STAMPS
from npred.plants import Plant, make
from npred.prediction.methods import RK4

DT = 0.01
SEEKING = npred.DelayObserver(bounds=(0.05, 0.4))


class Motor:
    """A motor's angle and speed, driven by its current."""

    states, inputs = ("angle", "speed"), ("i",)
    box, input_bounds = {"angle": (-3.0, 3.0), "speed": (-5.0, 5.0)}, ((-20.0, 20.0),)
    f = lambda x, u, t, p, M: [x.speed, M.sin(x.angle) - 0.5 * x.speed + u.i]
    kappa = lambda x, t, p, M: [-M.sin(x.angle) - 2 * x.angle - 2 * x.speed]
    V = lambda x, t, p, M: x.angle**2 + x.speed**2


MOTOR = Plant("motor", Motor)


def motor(D_hat=0.2, law=None, **named):
    return npred.controller(MOTOR, RK4(MOTOR, 41), law, DT, D_hat=D_hat, actuator="history", **named)


class Truth:
    """The motor by SciPy, with the commands at the times at which they were sent, late by D."""

    def __init__(self, D=0.2, X=(0.5, 0.0), plant=MOTOR):
        self.D, self.t, self.X, self.sent, self.plant = D, 0.0, np.array(X), [(-np.inf, 0.0)], plant

    def send(self, t, U):
        self.sent.append((t, float(U[0])))

    def to(self, t):
        """The state at t, piece by piece between two commands."""
        times = [s + self.D for s, _ in self.sent if self.t < s + self.D < t]
        for end in [*times, t]:
            U = max((s, u) for s, u in self.sent if s + self.D <= self.t + 1e-12)[1]
            f = lambda s, x, U=U: self.plant.f(x, np.array([U]), s)
            if end > self.t:
                self.X = solve_ivp(f, (self.t, end), self.X, rtol=1e-10, atol=1e-12).y[:, -1]
            self.t = end
        return self.X


@pytest.mark.parametrize("law", [None, npred.DelayObserver(bounds=(0.05, 0.5))])
def test_ideal_timing_by_stamps_is_the_plain_step_to_the_bit(law):
    plain, stamped, truth = motor(law=law), motor(law=law), Truth()
    for k in range(300):
        X = truth.to(k * DT)
        U = plain.step(X).copy()
        assert (stamped.step(X, t=k * DT, sampled_at=k * DT) == U).all()
        assert plain.D_hat == stamped.D_hat and (plain.P == stamped.P).all()
        truth.send(k * DT, U)
    assert np.abs(truth.X).max() < 0.1


def test_a_call_a_millionth_of_a_step_off_is_on_the_regular_clock_to_the_bit():
    """A clock that counts in such steps, as one of microseconds does for a call each second, is regular."""
    plain, stamped, rng = motor(), motor(), np.random.default_rng(0)
    for k in range(50):
        X, off = np.array([0.5, 0.1 * np.sin(k)]), 0.95e-6 * DT * rng.uniform(-1, 1, 2)
        assert (plain.step(X) == stamped.step(X, t=k * DT + off[0], sampled_at=k * DT + off[0] - abs(off[1]))).all()
        assert plain.t == stamped.t


def test_a_clock_that_runs_fast_by_more_than_that_is_followed_call_by_call():
    """It drifts: a controller that kept its own time would soon take a command for one of another control step."""
    followed, rate = motor(), 1 + 1.5e-6
    for k in range(50):
        followed.step([0.5, 0.0], t=k * DT * rate)
        assert followed.t - DT == pytest.approx(k * DT * rate, abs=1e-9 * DT)


@pytest.mark.parametrize(("off", "same"), [(0.95e-6, True), (1.5e-6, False)])
def test_a_sample_is_as_old_as_its_stamp_says_to_a_millionth_of_a_step(off, same):
    whole, other = motor(), motor()
    for k in range(20):
        X = np.array([0.5, 1.0])
        U = whole.step(X, t=k * DT, sampled_at=(k - 3) * DT), other.step(X, t=k * DT, sampled_at=(k - 3 - off) * DT)
    assert (U[0] == U[1]).all() == (whole.X_hat == other.X_hat).all() == same


def test_the_clock_may_begin_at_any_time():
    plain, stamped = motor(), motor()
    for k in range(50):
        X = np.array([0.5, 0.1 * k])
        np.testing.assert_allclose(plain.step(X), stamped.step(X, t=1e4 + k * DT), rtol=1e-13)
    assert stamped.t == pytest.approx(1e4 + 0.5)


def test_between_samples_the_state_is_the_models_with_the_commands_at_their_times():
    """Calls come 40 % early or late, each third one has a sample, which is 4 control steps old; X_hat against SciPy."""
    rng, controller, truth = np.random.default_rng(0), motor(), Truth()
    past, worst = [], 0.0
    for k in range(400):
        t = k * DT + (0.4 * DT * rng.uniform(-1, 1) if k else 0.0)
        past.append((t, truth.to(t).copy()))
        taken = k == 0 or (k > 4 and k % 3 == 0)
        at, X = past[max(k - 4, 0)]
        U = controller.step(X if taken else None, t=t, sampled_at=at if taken else None)
        worst = max(worst, np.abs(controller.X_hat - truth.X).max())
        truth.send(t, U)
        assert controller.status.late == controller.status.refused == 0
    assert worst < 2e-3  # a command that switches within a control step is spread over that
    assert np.abs(truth.X).max() < 0.02


def test_with_calls_on_time_late_samples_cost_rounding_errors_alone():
    controller, exact, truth = motor(outlier_limit=None), motor(outlier_limit=None), Truth()
    past = [truth.X]
    for k in range(200):
        X = truth.to(k * DT)
        past.append(X.copy())
        U = exact.step(X).copy()
        late = min(k, 7)
        lagged = controller.step(past[-1 - late], t=k * DT, sampled_at=(k - late) * DT)
        np.testing.assert_allclose(controller.X_hat, X, atol=1e-8)
        np.testing.assert_allclose(lagged, U, atol=1e-6)
        truth.send(k * DT, U)


def test_samples_that_are_old_doubled_or_out_of_order_are_counted_and_not_used():
    controller = motor(max_sample_age=0.05)
    controller.step([0.5, 0.0], t=0.0)
    controller.step([0.5, 0.0], t=DT, sampled_at=0.0)  # doubled
    controller.step([0.5, 0.0], t=2 * DT, sampled_at=1.5 * DT)
    controller.step([0.5, 0.0], t=3 * DT, sampled_at=1.2 * DT)  # older than the last one
    controller.step(None, t=9 * DT)
    assert controller.status.late == 2 and controller.status.age == pytest.approx(7.5 * DT)
    controller.step([0.5, 0.0], t=10 * DT, sampled_at=4 * DT)  # six control steps old
    assert controller.status.late == 3
    controller.step([0.5, 0.0], t=11 * DT, sampled_at=6 * DT)
    assert controller.status.late == 3 and controller.status.age == pytest.approx(5 * DT)


@given(st.lists(st.floats(0.2, 3.0), min_size=3, max_size=60), st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None)
def test_the_history_has_the_integral_of_the_commands_whatever_the_calls_times(gaps, seed):
    """Between control steps of its clock, by a sum over the calls."""
    rng, controller = np.random.default_rng(seed), motor()
    times, sent, t = [], [], 0.0
    for gap in gaps:
        U = controller.step(rng.uniform(-1, 1, 2), t=t)[0]
        times.append(t)
        sent.append(U)
        t += gap * DT
    controller.step([0.0, 0.0], t=t)
    z, rows, first = controller.memory.signals, len(controller.memory.signals.held), controller.memory.clock["at"]
    ends = np.array([*times, t]) / DT - t / DT + first  # positions of the calls
    for i in range(max(int(ends[0]), int(first) + 1 - rows) + 1, int(first)):
        overlap = np.clip(np.minimum(ends[1:], i + 1) - np.maximum(ends[:-1], i), 0, None)
        assert z.held[i % rows, 0, 0] == pytest.approx(overlap @ sent, abs=4e-6)  # times are on the clock within 1e-6


def test_a_command_that_was_not_sent_is_corrected_at_the_next_call():
    """With what the actuator got instead the model's state is the truth's, and without it is not."""
    informed, silent, truth, kept = motor(), motor(), Truth(), None
    for k in range(60):
        X = truth.to(k * DT) if k < 20 else None
        lost = k in (12, 13, 14, 15)
        before = {} if k - 1 not in (12, 13, 14, 15) else {"applied": kept}
        U = informed.step(X, t=k * DT, **before).copy()
        silent.step(X, t=k * DT)
        kept = kept if lost else U
        truth.send(k * DT, kept)
    X = truth.to(59 * DT)
    assert np.abs(informed.X_hat - X).max() < 1e-8 < 1e-3 < np.abs(silent.X_hat - X).max()


def test_after_a_pause_of_many_histories_nothing_is_expected():
    controller = motor()
    controller.step([0.5, 0.0], t=0.0)
    with pytest.raises(DivergedError, match=r"expected a sample of X, .* got none"):
        controller.step(None, t=100.0)
    assert np.isfinite(controller.step([2.9, -4.0], t=100.01)).all() and controller.status.missed == 0


def test_a_pause_within_the_history_is_predicted_over():
    controller, truth = motor(), Truth()
    t = 0.0
    for k in range(100):
        t += DT if k != 50 else 0.05
        U = controller.step(truth.to(t) if k != 50 else None, t=t)
        np.testing.assert_allclose(controller.X_hat, truth.to(t), atol=1e-6)
        truth.send(t, U)


def test_a_saved_controller_goes_on_between_two_samples():
    controller, other = motor(), motor()
    rng = np.random.default_rng(1)
    t = 0.0
    for k in range(40):
        t += DT * rng.uniform(0.5, 1.5)
        X = rng.uniform(-1, 1, 2) if k % 4 == 0 else None
        U = controller.step(X, t=t, sampled_at=None if X is None else t - 0.003).copy()
        if k >= 20:
            assert (other.step(X, t=t, sampled_at=None if X is None else t - 0.003) == U).all()
        if k == 19:
            other.restore(controller.state())


@pytest.mark.parametrize("stamp", ["at", "lag"])
def test_a_saved_clock_without_a_position_is_refused(stamp):
    controller = motor()
    controller.step([0.5, 0.0], t=0.0)
    before = controller.state()
    clock = list(before["clock"])
    clock[STAMPS.index(stamp)] = None
    with pytest.raises(ConfigError, match="expected the commands of such a controller, got others"):
        controller.restore(before | {"clock": clock})
    assert controller.state() == before


@pytest.mark.parametrize("time", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("calls", [0, 1, 5])
def test_a_time_that_is_not_finite_is_refused_and_changes_nothing(time, calls):
    controller = motor(law=SEEKING)
    for _ in range(calls):
        controller.step([0.5, 0.0])
    before = controller.state()
    for stamps in ({"t": time}, {"sampled_at": time}, {"t": controller.t, "sampled_at": time}):
        with pytest.raises(ConfigError, match=rf"{[*stamps][-1]}: expected a .*time.*, got -?(nan|inf); use one clock"):
            controller.step([0.5, 0.0], **stamps)
    with pytest.raises(ConfigError, match="t: expected a finite time"):
        controller.t = time
    assert str(controller.state()) == str(before)


def test_until_a_sample_tells_the_state_it_says_what_is_missing():
    controller = motor(max_sample_age=0.1)
    said = "step: expected a sample of X, for nothing tells the state, got "
    with pytest.raises(DivergedError, match=f"{said}none; keep the actuator at the last U"):
        controller.step(None)
    with pytest.raises(DivergedError, match=f"{said}one that is 0.3 s old, more than max_sample_age = 0.1 s; keep"):
        controller.step([0.5, 0.0], sampled_at=controller.t - 0.3)
    with pytest.raises(DivergedError, match="step: expected finite X, got one that is not; keep"):
        controller.step([np.nan, 0.0])
    assert np.isfinite(controller.step([0.5, 0.0], sampled_at=controller.t - 0.05)).all()
    with pytest.raises(DivergedError, match=f"{said}none; keep"):
        controller.step(None, t=controller.t + 100.0)  # so long that the model expects nothing any more
    with pytest.raises(DivergedError, match="expected a finite first X, for u0 is kappa of it, got one that is not"):
        motor(u0="law").step([np.nan, 0.0])


def test_times_that_cannot_be_are_refused_in_one_line():
    controller = motor()
    controller.step([0.5, 0.0], t=1.0)
    with pytest.raises(ConfigError, match=r"t: expected a finite time after that of the last call, 1, got 0\.5"):
        controller.step(None, t=0.5)
    with pytest.raises(ConfigError, match=r"sampled_at: expected a time up to that of the call, 1\.01, got 1\.5"):
        controller.step([0.5, 0.0], t=1.01, sampled_at=1.5)
    measured = npred.controller(MOTOR, RK4(MOTOR, 41), None, DT, D_hat=0.2, actuator="measured")
    with pytest.raises(ConfigError, match='t: expected actuator="history"'):
        measured.step([0.5, 0.0], np.zeros((41, 1)), t=1.0)
    with pytest.raises(ConfigError, match=r"observer: expected one of npred\.observers, got 'ekf'"):
        motor(observer="ekf")
    for name, value in {"max_sample_age": 0.1, "watchdog": npred.Watchdog(0.1)}.items():
        with pytest.raises(ConfigError, match=f'{name}: expected actuator="history"'):
            npred.controller(MOTOR, RK4(MOTOR, 41), None, DT, D_hat=0.2, actuator="measured", **{name: value})


@pytest.mark.parametrize("then", ["hold", "zero", 3.0, lambda x, t, p, M: [-x.speed]])
def test_the_watchdog_hands_over_as_declared_and_returns_without_a_jump(then):
    """Samples stop for 20 control steps; the watchdog waits 5, and U moves by 0.05 in a call while it changes hands."""
    controller = motor(watchdog=npred.Watchdog(5.5 * DT, then, jump=0.05))
    before, path = None, []
    for k in range(200):
        X = None if 50 <= k < 70 else np.array([0.3 * np.cos(0.01 * k), 0.2])
        U = controller.step(X, t=k * DT).copy()
        handed = controller.status.handed_over
        assert handed == (55 <= k < 70)
        if before is not None and (handed or 70 <= k < 75):
            assert abs(U - before)[0] <= 0.05 + 1e-12
        if k == 54:
            held = U
        path.append(U[0])
        before = U
    expected = {"hold": held[0], "zero": max(0.0, abs(held[0]) - 0.75) * np.sign(held[0])}
    if isinstance(then, str):
        assert path[69] == pytest.approx(expected[then], abs=1e-12)
    law = motor()
    free = [law.step([0.3 * np.cos(0.01 * k), 0.2], t=k * DT)[0] for k in range(200)]
    assert abs(path[-1] - free[-1]) < 0.05  # it is the law's again


class Stretched(Motor):
    """Its delay is that of its angle."""

    delay = lambda x, t, p, M: 0.1 + 0.01 * x.angle


@pytest.mark.parametrize("kind", [Motor, Stretched])
def test_a_watchdog_has_u_before_the_first_sample(kind):
    plant, D_hat = Plant(kind.__name__, kind), None if kind is Stretched else 0.2
    controller = npred.controller(
        plant, RK4(plant, 11), None, DT, D_hat=D_hat, actuator="history", watchdog=npred.Watchdog(0.1, then=1.5)
    )
    assert controller.step(None, t=0.0) == pytest.approx(1.5) and controller.status.handed_over
    assert controller.status.age == np.inf and np.isfinite(controller.D_hat)
    controller.step([0.5, 0.0], t=DT)
    assert not controller.status.handed_over


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"after": 0.0}, "expected a time above 0"),
        ({"after": 0.1, "then": "stop"}, "then: expected numbers, a law or one of hold, zero"),
        ({"after": 0.1, "jump": -1.0}, "expected numbers above 0 as jump"),
    ],
)
def test_a_watchdog_that_makes_no_sense_is_refused(named, message):
    with pytest.raises(ConfigError, match=message):
        npred.Watchdog(**named)


@pytest.mark.parametrize("D", [0.12, 0.2])
def test_the_delay_is_found_with_jitter_and_late_samples(D):
    """30 % jitter of the calls, samples 4 control steps old, 5 % of them lost: one control step, and 2 %."""
    rng, truth = np.random.default_rng(2), Truth(D, X=(1.5, 0.0))
    controller, past = motor(0.3, npred.DelayObserver(bounds=(0.05, 0.4))), []
    for k in range(500):
        t = k * DT + (0.3 * DT * rng.uniform(-1, 1) if k else 0.0)
        past.append((t, truth.to(t).copy()))
        at, X = past[max(k - 4, 0)]
        came = k == 0 or rng.uniform() > 0.05
        U = controller.step(X if came else None, t=t, sampled_at=at if came else None)
        truth.send(t, U)
    assert abs(controller.D_hat - D) < DT + 0.02 * D
    assert controller.status.D_hat_spread < 0.4


REFUSED = {  # what raises ConfigError, of a controller whose last call was at `last`
    "a sample of the future": lambda c, last: c.step([0.4, 0.1], t=last + 0.7, sampled_at=last + 0.7 + 1.5 * DT),
    "a state of another shape": lambda c, last: c.step([0.4], t=last + 0.7),
    "u as well": lambda c, last: c.step([0.4, 0.1], np.zeros((41, 1)), t=last + 0.7),
    "a command that is none": lambda c, last: c.step([0.4, 0.1], t=last + 0.7, applied=[np.inf]),
    "no number": lambda c, last: c.step([0.4, 0.1], t=last + 0.7, applied=[1.0], sampled_at="now"),
    "infinity": lambda c, last: c.step([0.4, 0.1], t=np.inf),
    "an estimate of a state": lambda c, last: c.restore(other() | {"D_hat": 9.0}),
    "steps of a state": lambda c, last: c.restore(other() | {"step": -1}),
    "phi of a state": lambda c, last: c.restore(other() | {"phi": np.inf}),
    "a time of a state": lambda c, last: c.restore(other() | {"t0": np.nan}),
    "commands of a state": lambda c, last: c.restore(other() | {"commands": {"k": 0, "held": [], "sums": []}}),
    "a clock of a state": lambda c, last: c.restore(other() | {"clock": [1.0]}),
    "an estimate": lambda c, last: setattr(c, "D_hat", 9.0),
    "a time": lambda c, last: setattr(c, "t", np.inf),
}


def other():
    """The state of a controller that has stepped elsewhere."""
    controller = motor(law=npred.DelayObserver(bounds=(0.05, 0.5)))
    for k in range(9):
        controller.step([0.1 * k, -0.2])
    return controller.state()


@pytest.mark.parametrize("steps", [0, 30])
@pytest.mark.parametrize("u0", [None, "law"])
@pytest.mark.parametrize("name", REFUSED)
def test_a_call_that_is_refused_changes_nothing(name, u0, steps):
    law = npred.DelayObserver(bounds=(0.05, 0.5))
    controller, twin = motor(law=law, u0=u0), motor(law=law, u0=u0)
    for k in range(steps):
        for each in (controller, twin):
            each.step([0.5 - 0.01 * k, 0.1], t=3.0 + k * DT)
    saved = controller.state()
    with pytest.raises(ConfigError):
        REFUSED[name](controller, controller.t - DT)
    assert controller.state() == saved
    for k in range(3):
        t = 3.0 + (steps + k) * DT
        np.testing.assert_array_equal(controller.step([0.3, 0.2], t=t), twin.step([0.3, 0.2], t=t))
    assert controller.state() == twin.state()


def test_a_first_state_that_is_not_finite_starts_no_clock():
    controller = motor(u0="law")
    with pytest.raises(DivergedError):
        controller.step([np.nan, 0.0], t=3.0, applied=[1.0])
    assert controller.t == 0.0 and not controller.state()["clock"][7]


def test_samples_just_before_the_control_steps_find_the_delay_as_those_on_them():
    """They are two old, and a ten-thousandth more: the estimate is the same within a hundredth of one in each call."""

    def found(early):
        truth, controller, past, series = Truth(0.12, X=(1.5, 0.0)), motor(0.3, SEEKING), [], []
        for k in range(60):
            taken = max(k - early, 0.0) * DT
            past.append((taken, truth.to(taken).copy()))
            at, X = past[max(k - 2, 0)]
            came = k == 0 or k > 2
            U = controller.step(X if came else None, t=k * DT, sampled_at=at if came else None)
            series.append(controller.D_hat)
            truth.send(k * DT, U)
        return np.array(series)

    on_time = found(0.0)
    assert on_time[0] == 0.3 and abs(on_time[-1] - 0.12) < 1e-3
    np.testing.assert_allclose(found(1e-4), on_time, rtol=0, atol=1e-2 * DT)


def test_the_jump_of_a_watchdog_limits_u_at_no_other_time():
    """Not before it takes U, and not after the law has it back: a state that steps has the law's U at once."""
    guarded, law = motor(watchdog=npred.Watchdog(5.5 * DT, "zero", jump=0.05)), motor()
    sent, free, handed = [], [], []
    for k in range(150):
        X = None if 50 <= k < 60 else np.array([0.3 if k // 10 % 2 else 0.2, 0.1])
        free.append(law.step(X, t=k * DT, applied=sent[-1] if sent else None).copy())
        sent.append(guarded.step(X, t=k * DT).copy())
        handed.append(guarded.status.handed_over)
    steps, apart = np.abs(np.diff(np.ravel(sent))), np.abs(np.subtract(sent, free)).ravel()
    limited = np.flatnonzero(apart > 1e-12)
    assert np.flatnonzero(handed).tolist() == [55, 56, 57, 58, 59]
    assert limited[0] == 55 and 60 <= limited[-1] < 70 and steps[54:69].max() <= 0.05 + 1e-12
    assert steps[:50].max() > 0.1 and steps[80:].max() > 0.1


def test_a_pause_of_two_histories_is_predicted_over():
    """The last command was held, so that the model knows where the plant is."""
    controller, truth = motor(), Truth()
    for k in range(30):
        truth.send(k * DT, controller.step(truth.to(k * DT), t=k * DT))
    pause = 2 * len(controller.memory.signals.held) * DT
    t = 29 * DT + pause
    controller.step(None, t=t)
    np.testing.assert_allclose(controller.X_hat, truth.to(t), atol=1e-6)


class Rocked(Motor):
    """The motor on a ship, seen by its angle to the horizon."""

    outputs = ("to_horizon",)
    f = lambda x, u, t, p, M: [x.speed, M.sin(x.angle) - 0.5 * x.speed + u.i + 3.0 * M.cos(9.0 * t)]
    output = lambda x, t, p, M: [x.angle + M.sin(5.0 * t)]


ROCKED = Plant("rocked", Rocked)


@pytest.mark.parametrize("observed", [False, True])
def test_samples_that_are_late_are_brought_to_now_by_the_time_at_which_they_were_taken(observed):
    """Of a plant and an output that time moves: five control steps of age, each other call without a sample."""
    observer = npred.observers.EKF(ROCKED, X0=[0.5, 0.0]) if observed else None
    controller = npred.controller(
        ROCKED, RK4(ROCKED, 41), None, DT, D_hat=0.2, actuator="history", observer=observer, outlier_limit=None
    )
    truth, past, worst = Truth(plant=ROCKED), [], 0.0
    for k in range(80):
        t = k * DT
        past.append(truth.to(t).copy())
        at, X = max(k - 5, 0) * DT, past[max(k - 5, 0)]
        Y = ROCKED.output(X, at) if observed else X
        came = k == 0 or (k > 5 and k % 2 == 0)
        U = controller.step(Y if came else None, t=t, sampled_at=at if came else None)
        worst = max(worst, np.abs(controller.X_hat - truth.X).max())
        truth.send(t, U)
    assert worst < 1e-5


def test_an_observer_begins_at_its_first_state_where_no_sample_comes():
    ekf = npred.observers.EKF(ROCKED, X0=[0.5, -1.0])
    controller = npred.controller(ROCKED, RK4(ROCKED, 41), None, DT, D_hat=0.2, actuator="history", observer=ekf)
    controller.step(None, t=0.0)
    np.testing.assert_array_equal(controller.X_hat, [0.5, -1.0])


def test_an_observer_does_not_go_back_for_a_sample_older_than_one_that_it_refused():
    """By then it is at the time of the refused one, whose sample of the step before is counted as late."""
    used, without = (
        npred.controller(
            ROCKED, RK4(ROCKED, 41), None, DT, D_hat=0.2, actuator="history",
            observer=npred.observers.EKF(ROCKED, X0=[0.0, 0.0]),
        )
        for _ in range(2)
    )  # fmt: skip
    for k in range(7):
        for controller in (used, without):
            Y = 50.0 if k == 6 else np.sin(5 * k * DT)
            controller.step([Y] if k < 4 or k == 6 else None, t=k * DT)
    used.step([0.3], t=7 * DT, sampled_at=5 * DT)
    without.step(None, t=7 * DT)
    assert used.status.refused == without.status.refused == 1
    assert (used.status.late, without.status.late) == (1, 0)
    np.testing.assert_array_equal(used.X_hat, without.X_hat)


@pytest.mark.parametrize("gap", [1.0, 2.0, 3.5])
def test_while_no_call_comes_the_estimate_goes_on_by_its_last_rate(gap):
    """Then by the method of Adams and Bashforth, as in each call; the commands are read by what it is by then."""
    gamma, controller = 0.4, motor(0.2, npred.DelayAdaptation(0.4, 1.0, (0.05, 0.5)))
    for k in range(6):
        controller.step([0.5 - 0.01 * k, 0.1], t=k * DT)
    before, phi = controller.D_hat, controller.state()["phi"]
    controller.step([0.4, 0.1], t=(5 + gap) * DT)
    read = before + gamma * DT * (gap - 1) * phi
    assert controller.memory.signals.D_seen[0, 0] == pytest.approx(read, abs=1e-12) and phi != 0
    after = read + gamma * DT * (1.5 * controller.state()["phi"] - 0.5 * phi)
    assert controller.D_hat == pytest.approx(after, abs=1e-12)


@pytest.mark.parametrize("gamma", [30.0, -30.0])
def test_over_a_pause_the_estimate_stays_within_its_bounds(gamma):
    low, high = 0.15, 0.25
    controller = motor(0.2, npred.DelayAdaptation(abs(gamma), 1.0, (low, high)))
    for k in range(4):
        controller.step([0.5, np.sign(gamma) * 3.0], t=k * DT)
    controller.step([0.4, 0.1], t=(3 + 30) * DT)
    assert low <= controller.memory.signals.D_seen[0, 0] <= high


@pytest.mark.parametrize("early", [0.0, 0.45])
def test_each_second_sample_finds_the_delay_also_late_and_between_control_steps(early):
    """Four steps old, and some; a call without one takes nothing from the next. Within a tenth of a control step."""
    truth, controller, past = Truth(0.12, X=(1.5, 0.0)), motor(0.3, SEEKING), []
    for k in range(120):
        taken = max(k - early, 0.0) * DT
        past.append((taken, truth.to(taken).copy()))
        at, X = past[max(k - 4, 0)]
        came = k == 0 or (k > 4 and k % 2 == 0)
        truth.send(k * DT, controller.step(X if came else None, t=k * DT, sampled_at=at if came else None))
    assert abs(controller.D_hat - 0.12) < 0.1 * DT


class Winch(Motor):
    """Two motors; the first one's rescue current is a parameter."""

    states, inputs, parameters = ("angle", "speed"), ("i", "j"), {"rescue": 1.0}
    input_bounds = ((-20.0, 20.0), (-2.0, 2.0))
    f = lambda x, u, t, p, M: [x.speed + u.j, u.i]
    kappa = lambda x, t, p, M: [-x.angle - x.speed, -0.5 * x.angle]


class CalledWinch:
    """The same, called."""

    traced = False
    states, inputs, parameters, input_bounds = Winch.states, Winch.inputs, Winch.parameters, Winch.input_bounds
    f = lambda X, u, t, p: np.stack([X[:, 1] + u[:, 1], u[:, 0]], axis=1)
    kappa = lambda X, t, p: np.stack([-X[:, 0] - X[:, 1], -0.5 * X[:, 0]], axis=1)


def winch(then, jump=None, kind=Winch):
    plant = make("winch", kind, {"rescue": 3.0})
    return npred.controller(
        plant, RK4(plant, 21), None, DT, D_hat=0.1, actuator="history", watchdog=npred.Watchdog(1.5 * DT, then, jump)
    )


@pytest.mark.parametrize(
    ("kind", "law"),
    [
        (Winch, lambda x, t, p, M: [p.rescue + 0 * x.angle, 90.0 + 0 * x.angle]),
        (CalledWinch, lambda X, t, p: np.stack([p.rescue + 0 * X[:, 0], 90.0 + 0 * X[:, 0]], axis=1)),
    ],
)
def test_the_law_of_a_watchdog_has_the_plants_parameters_and_the_bounds_of_u(kind, law):
    controller = winch(law, kind=kind)
    controller.step([0.5, 0.0], t=0.0)
    U = [controller.step(None, t=k * DT).copy() for k in (1, 2)][-1]
    assert controller.status.handed_over and U.tolist() == [3.0, 2.0]


def test_each_input_has_a_jump_of_its_own():
    controller = winch((5.0, 1.5), jump=(0.5, 0.02))
    before = controller.step([0.5, 0.0], t=0.0).copy()
    U = [controller.step(None, t=k * DT).copy() for k in (1, 2)][-1]
    assert controller.status.handed_over
    np.testing.assert_allclose(U - before, [0.5, 0.02], atol=0.011)
