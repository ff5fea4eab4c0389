"""The exported controller on a real clock: what it says and remembers is npred.controller's, in double to the bit."""

import json
import subprocess

import numpy as np
import pytest
from c_controllers import FLAGS, InC, library, needs_gcc
from conftest import HERE
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from varying_delays import with_delay

import npred
from npred.base.errors import ConfigError, DivergedError
from npred.exports import c_controller
from npred.plants import Plant

pytestmark = [needs_gcc, pytest.mark.usefixtures("quickly_compiled")]
DT = 0.01
PAPER, UNICYCLE = npred.plant("activator_repressor"), npred.plant("unicycle")
CHEMOSTAT, CART = npred.plant("chemostat"), npred.plant("cart_pole")
IN_SPACE = with_delay(lambda x, t, p, M: 0.1 * (x.x**2 + x.y**2) + 0.1)
START = {PAPER.name: [0.03, 30.0], UNICYCLE.name: [0.3, -0.2, 0.2], IN_SPACE.name: [0.3, -0.2, 0.2]}
START |= {CHEMOSTAT.name: [2.0, 2.0], CART.name: [0.1, 0.0, 0.05, 0.0]}
REST = {"hold": "hold", "zero": "zero", "numbers": [0.2, -0.1], "law": lambda x, t, p, M: [-0.5 * x.x, -x.theta]}


class Motor:
    """A motor's angle and speed, driven by its current; the angle is measured."""

    states, inputs, outputs = ("angle", "speed"), ("i",), ("cosine", "sine")
    box, input_bounds = {"angle": (-3.0, 3.0), "speed": (-5.0, 5.0)}, ((-20.0, 20.0),)
    f = lambda x, u, t, p, M: [x.speed, M.sin(x.angle) - 0.5 * x.speed + u.i]
    output = lambda x, t, p, M: [M.cos(x.angle), M.sin(x.angle)]
    kappa = lambda x, t, p, M: [-M.sin(x.angle) - 2 * x.angle - 2 * x.speed]
    V = lambda x, t, p, M: x.angle**2 + x.speed**2
    safe = lambda x, t, p, M: [0.15 - x.speed, 0.15 + x.speed]


MOTOR = Plant("motor", Motor)
START[MOTOR.name] = [0.5, 0.0]


def controller(plant, law=None, D_hat=0.2, nx=21, **named):
    D = None if plant.declares_delay else D_hat
    return npred.controller(plant, npred.predictor(plant, "heun", nx), law, DT, D_hat=D, actuator="history", **named)


def watched(then):
    watchdog = npred.Watchdog(6.5 * DT, REST[then], jump=[0.03, np.inf])
    return controller(UNICYCLE, watchdog=watchdog)


def delays(bounds=(0.05, 0.4)):
    return npred.DelayObserver(bounds=bounds, candidates=15)


CASES = {
    "one input": lambda: controller(PAPER),
    "two inputs": lambda: controller(UNICYCLE, max_sample_age=0.08),
    "no gate": lambda: controller(UNICYCLE, outlier_limit=None),
    "declared": lambda: controller(IN_SPACE),
    "declared, watchdog": lambda: controller(IN_SPACE, watchdog=npred.Watchdog(6.5 * DT, "zero")),
    "law of phi": lambda: controller(PAPER, npred.L1Adaptation(0.01, bounds=(0.1, 0.5))),
    "observer of the delay": lambda: controller(MOTOR, delays()),
    "guard": lambda: npred.controller(
        PAPER, npred.guarded(npred.predictor(PAPER, "euler", 21), 1e-5), None, DT, D_hat=0.2, actuator="history"
    ),
    **{f"watchdog, {then}": lambda then=then: watched(then) for then in REST},
    "EKF": lambda: controller(MOTOR, observer=npred.observers.EKF(MOTOR)),
    "EKF, two inputs": lambda: controller(UNICYCLE, observer=npred.observers.EKF(UNICYCLE, outputs=("x", "y"))),
    "EKF, offset, both": lambda: controller(
        MOTOR, delays(), observer=npred.observers.EKF(MOTOR, offset=True), watchdog=npred.Watchdog(0.2, "zero")
    ),
    "EKF, no gate": lambda: controller(MOTOR, observer=npred.observers.EKF(MOTOR), outlier_limit=None),
    "safety filter": lambda: controller(MOTOR, delays(), safety=npred.SafetyFilter(3.0, delay=0.02)),
    "safety filter, delay known": lambda: controller(MOTOR, safety=npred.SafetyFilter(3.0)),
    "safety filter, EKF, offset": lambda: controller(
        MOTOR, safety=npred.SafetyFilter(3.0, delay=0.02), observer=npred.observers.EKF(MOTOR, offset=True)
    ),
    "Luenberger": lambda: controller(MOTOR, observer=npred.observers.Luenberger(MOTOR, offset=True)),
    "chemostat": lambda: controller(
        CHEMOSTAT, observer=npred.observers.EKF(CHEMOSTAT, outputs=("S",), offset=True),
        watchdog=npred.Watchdog(0.3, "hold"),
    ),
    "cart": lambda: controller(CART, delays()),
}  # fmt: skip


class World:
    """A plant that gets each command its delay later, by small steps of RK4; only a maker of samples."""

    def __init__(self, plant, D=0.15):
        self.plant, self.D, self.t, self.X = plant, D, 0.0, np.array(START[plant.name])
        self.far = [1.5 * max(map(abs, plant.box.get(name, (0.0, 1.0)))) for name in plant.states]
        self.sent, self.past = [(-np.inf, np.zeros(plant.m))], [(0.0, np.array(START[plant.name]))]

    def acting(self, t):
        late = self.plant.delay(self.X, t) if self.plant.declares_delay else self.D
        return np.array([
            next(U[j] for at, U in reversed(self.sent) if at <= t - ratio * late + 1e-12)
            for j, ratio in enumerate(self.plant.ratios)
        ])  # fmt: skip

    def to(self, t):
        steps = max(1, min(200, int((t - self.t) / DT * 2)))
        h = (t - self.t) / steps
        for k in range(steps):
            at = self.t + k * h
            U, f = self.acting(at), self.plant.f
            a = f(self.X, U, at)
            b = f(self.X + h / 2 * a, U, at)
            self.X = self.X + h * f(self.X + h / 2 * b, U, at)
        self.X = np.where(np.abs(self.X) < self.far, self.X, START[self.plant.name])
        self.t = t
        self.past.append((t, self.X.copy()))


class Pair:
    """A controller in Python and its export, which get the same calls; each call asserts that they agree."""

    def __init__(self, python, compiled, limit=0.0, precision="double"):
        self.python, self.c = python, InC(compiled, python.plant, precision)
        self.compiled, self.limit, self.precision = compiled, limit, precision
        self.size, self.codes, self.handed = np.full(python.plant.m, 1e-300), [], 0
        self.filtered = 0

    def call(self, t, X=None, sampled_at=None, applied=None):
        if applied is not None:
            assert self.c.applied(applied) == 0
        code, U_c = self.c.step_at(t, X, t if sampled_at is None else sampled_at)
        U, refusal = self.of_python(t, X, sampled_at, applied)
        assert code == refusal and np.isnan(U_c).all() == (code != 0)
        self.size = np.maximum(self.size, np.abs(U))
        if code == 0:
            assert (np.abs(U_c - U) <= self.limit * self.size).all(), (U_c, U)
        if self.limit == 0:
            np.testing.assert_array_equal(self.state_of_c(), self.state_of_python())
        self.codes.append(code)
        self.compare()
        return U

    def of_python(self, t, X, sampled_at, applied):
        """The U that the actuator holds after the call, and its code."""
        try:
            return self.python.step(X, t=t, sampled_at=sampled_at, applied=applied).copy(), 0
        except ConfigError:
            return self.python.memory.signals.U[:, 0].copy(), 3
        except DivergedError as refusal:
            reason = str(refusal)
            words = {"finite X, got": 1, "the prediction from X": 2, "raise history_length": 4, "a sample of X": 6}
            (code,) = (code for words, code in words.items() if words in reason)
            return self.python.memory.signals.U[:, 0].copy(), code

    def state_of_c(self):
        saved = bytes(self.c.state())[24:]  # behind the digest and the checksum
        return np.concatenate([np.frombuffer(saved[:8], np.int64).astype(float), np.frombuffer(saved[8:], float)])

    def state_of_python(self):
        python, z = self.python, self.python.memory.signals
        parts = [[python.memory.step, python.memory.t0], z.D_hat, z.phi_before, z.held, z.total, z.clock]
        parts += [z.observer] if python.adaptation and "observer" in python.state() else []
        parts += [z.missed, z.filter if python.observer else [], z.plan]
        parts += [python.settings.p] if c_controller.settable(python) else []
        return np.concatenate([np.ravel(part) for part in parts])

    def compare(self):
        python, limit = self.python.status, self.limit
        status = self.c.status(len(self.python.outputs))
        exact = ("late", "refused", "missed", "handed_over", "fallback", "filtered", "unkept", "at_bound")
        assert [getattr(status, name) for name in exact] == [getattr(python, name) for name in exact]
        sizes = np.maximum(1.0, np.abs(START[self.python.plant.name]).max())
        limits = {"D_hat": (1, 0), "age": (1, 1), "D_hat_spread": (1e3, 0), "error": (1e6, 0), "kept": (1e3, 10)}
        for name, (relative, absolute) in (limits | {"innovation": (10, 10 * sizes)}).items():
            of_c, of_python = np.array(getattr(status, name)), np.array(getattr(python, name))
            near = np.isclose(of_c, of_python, rtol=limit * relative, atol=limit * absolute, equal_nan=True)
            assert near.all(), (name, of_c, of_python)
        assert (np.abs(np.array(status.offset) - python.offset) <= 10 * limit * self.size).all()
        self.handed += python.handed_over
        self.filtered += python.filtered

    def renew(self):
        """Go on with two new ones that get the saved states."""
        saved, state = self.c.state(), json.loads(json.dumps(self.python.state()))
        self.python, self.c = self.python.fresh(), InC(self.compiled, self.python.plant, self.precision)
        self.python.restore(state)
        assert self.c.restore(saved) == 0


WHATS = ("now", "now", "late", "late", "none", "none", "again", "far", "nan", "future", "applied", "save", "set time")
GAPS = (0.02, 0.0625, 2.0, 3.4, 12.0, 80.0, 300.0, 5e8)  # control steps of a pause; the last one is 60 days


def play(pair, events):
    """Call by call: (control steps since the last call, what happens, how many calls old a late sample is)."""
    plant = pair.python.plant
    world, wide = World(plant), np.ptp([plant.box.get(name, (0.0, 1.0)) for name in plant.states], axis=1)
    observer, shift, latest = pair.python.observer, 0.0, 0.0
    wide = wide * (0.6 if pair.python.outlier_limit else 0.1)
    sample = lambda X: X if observer is None else observer.measured(X)
    for k, (gap, what, old) in enumerate(events):
        if k:
            world.to(world.t + gap * DT)
        t, X, taken = world.t + shift, world.X, world.t
        named = {}
        if what == "late":
            taken, X = world.past[max(len(world.past) - 1 - old, 0)]
        elif what == "again":
            taken, X = world.past[-1] if latest is None else (latest, world.X)
        elif what == "future":
            taken = world.t + (0.5 if old % 2 else 3.0) * DT
        elif what == "applied":
            named["applied"] = 0.5 * world.sent[-1][1]
        elif what == "save":
            pair.renew()
        elif what == "set time" and k:
            shift += 1.7
            pair.python.t = t = world.t + shift
            assert pair.c.set_time(t) == 0
        Y = None if what == "none" else sample(X) + (what == "far") * (sample(X + wide) - sample(X))
        Y = 1000.0 * (sample(X) + 1.0) if what == "wild" else Y
        Y = np.full(np.shape(Y), np.nan) if what == "nan" else Y
        at = taken + shift
        U = pair.call(t, Y, None if Y is None or what in ("now", "save") else at, **named)
        latest = taken if Y is not None else latest
        world.sent.append((world.t, U))
        assert np.isfinite(pair.size).all()


def events_of(rng, count):
    """Calls 30 % early or late, some much so; samples of all kinds."""
    gaps = np.where(rng.random(count) < 0.4, 1.0, rng.uniform(0.7, 1.3, count))
    gaps = np.where(rng.random(count) < 0.05, rng.choice([0.02, 2.0, 3.4, 7.0], count), gaps)
    whats = rng.choice(WHATS, count, p=np.array([10, 10, 6, 6, 6, 6, 1, 1, 0.5, 0.5, 1, 0.5, 0.3]) / 48.8)
    whats[count // 3 : count // 3 + 12] = "none"
    return list(zip(gaps.tolist(), whats.tolist(), rng.integers(0, 30, count).tolist(), strict=True))


def any_of(rng, count):
    """Calls and samples without a rule, pauses and samples that cannot be among them."""
    gaps = np.where(rng.random(count) < 0.5, 1.0, rng.uniform(0.5, 2.0, count).round(4))
    gaps = np.where(rng.random(count) < 0.15, rng.choice(GAPS, count), gaps)
    whats = rng.choice([*WHATS, *6 * ["now"], "wild"], count)
    return list(zip(gaps.tolist(), whats.tolist(), rng.integers(0, 30, count).tolist(), strict=True))


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The library of a case, compiled once: name, precision -> a pair of new controllers."""
    made = {}

    def pair(name, precision="double", limit=0.0):
        if (name, precision) not in made:
            made[name, precision] = library(CASES[name](), tmp_path_factory.mktemp("stamps"), precision)
        return Pair(CASES[name](), made[name, precision], limit, precision)

    return pair


@pytest.mark.parametrize("name", CASES)
def test_a_loop_on_a_clock_is_that_of_python(compiled, name):
    pair = compiled(name)
    play(pair, events_of(np.random.default_rng(3), 400))
    status = pair.python.status
    assert status.late > 0 and pair.codes.count(0) > 300
    assert status.refused > 0 or pair.python.outlier_limit is None or name == "Luenberger"
    assert pair.handed > 0 or pair.python.watchdog is None
    assert pair.filtered > 0 or pair.python.safety is None


EVENT = st.tuples(
    st.one_of(st.just(1.0), st.floats(0.01, 3.0).map(lambda gap: round(gap, 4)), st.sampled_from([12.0, 80.0, 300.0])),
    st.sampled_from(WHATS),
    st.integers(0, 30),
)


@pytest.mark.parametrize(
    "name",
    ["two inputs", "declared", "declared, watchdog", "observer of the delay", "watchdog, law", "EKF, offset, both"],
)
@given(events=st.lists(EVENT, min_size=1, max_size=40))
@example(events=[(1.0, "none", 0), (1.0, "now", 0), (300.0, "none", 0), (1.0, "now", 0), (80.0, "now", 0)])
@example(events=[(1.0, "none", 0), (1.0, "save", 0), (1.0, "save", 0)])
@example(  # of one unit in the last place of a sample U makes 17
    events=[(1.0, "far", 0), (80.0, "now", 0), *6 * [(1.0, "now", 0)], (0.0625, "now", 0), *2 * [(1.0, "now", 0)],
            (12.0, "now", 0), (1.0, "now", 0), (12.0, "now", 0)]
)  # fmt: skip
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_calls_and_samples_are_those_of_python(compiled, name, events):
    play(compiled(name), events)


@pytest.mark.campaign
@pytest.mark.parametrize("name", CASES)
def test_any_run_is_that_of_python(compiled, name):
    """2000 of them in all."""
    for seed in range(2 + 2000 // len(CASES)):
        play(compiled(name), any_of(np.random.default_rng(seed), 40))


def test_the_header_names_the_outputs_that_a_step_takes():
    header, _ = c_controller.sources(CASES["EKF"]())
    assert "X, a sample: cosine, sine." in header and "States of P: angle, speed." in header
    assert "X, a sample: x (m), y (m), theta (rad)." in c_controller.sources(CASES["two inputs"]())[0]


@pytest.mark.parametrize("name", ["two inputs", "declared", "observer of the delay", "watchdog, zero", "EKF"])
def test_in_float_it_is_so_to_floats_rounding(compiled, name):
    events = [
        event for event in events_of(np.random.default_rng(4), 300) if event[1] in ("now", "late", "none", "save")
    ]
    play(compiled(name, "float", limit=2e-3), events)


def test_ideal_timing_by_stamps_is_the_plain_step_to_the_bit(compiled):
    """Also with a clock that shows hours: its rounding errors, of 1e-12 of a control step, are no jitter."""
    for name in ("one input", "observer of the delay", "EKF, offset, both"):
        pair, start = compiled(name), 4e4
        plain, stamped, world = pair.c, InC(pair.compiled, pair.python.plant), World(pair.python.plant)
        observer = pair.python.observer
        for k in range(200):
            world.to(k * DT)
            X = world.X if observer is None else observer.measured(world.X)
            U = plain.step(X)
            code, at = stamped.step_at(start + k * DT, X, start + k * DT)
            assert code == 0 and (at == U).all()
            world.sent.append((k * DT, U))


def test_a_time_that_cannot_be_changes_nothing(compiled):
    pair = compiled("two inputs")
    X = START[UNICYCLE.name]
    pair.call(5.0, X)
    before = bytes(pair.c.state())
    for t, at in ((5.0, 5.0), (4.0, 4.0), (np.nan, 5.0), (np.inf, 5.0), (5.01, 5.03), (5.01, np.nan), (5.01, -np.inf)):
        code, U = pair.c.step_at(t, X, at)
        assert code == 3 and np.isnan(U).all()
    assert bytes(pair.c.state()) == before
    pair.call(5.01, X, 5.015)  # by less than a control step of the future: two clocks


AT_ONCE = """
#include "npred.c"
int main(void)
{
    static npred_controller c;
    static npred_saved saved;
    npred_init(&c);
    npred_get_state(&c, &saved);
    for (int i = 0; i < NPRED_CLOCK; i++) {
        if (isnan(saved.clock[i]) != isnan(the_clock[i])) {
            return 2;
        }
    }
    return npred_set_state(&c, &saved);
}
"""


def test_it_begins_with_its_numbers_also_where_the_compiler_knows_wide_registers(tmp_path):
    """gcc 12 with AVX-512 once began with NaN for the lag, and refused the state that it had saved."""
    library(CASES["one input"](), tmp_path)
    (tmp_path / "at_once.c").write_text(AT_ONCE)
    command = ["gcc", "-std=c99", "-O2", "-march=native", "at_once.c", "-o", "at_once", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=120)
    assert subprocess.run([tmp_path / "at_once"], timeout=60).returncode == 0


RIG = """
#include <stdio.h>
static int call = -1;
static const double times[] = {CALLS}, samples[][3] = {SAMPLES};
double now(void) { return times[call]; }
int receive(double *X, double *taken)
{
    call++;
    X[0] = samples[call][0], X[1] = samples[call][1], *taken = samples[call][2];
    return *taken > 0;
}
int send(const double *U) { printf("%.17g\\n", U[0]); return call != 0 && call != 7; }
void acting(double *U) { U[0] = 0.002; }
void warn(void) { printf("warn\\n"); }
int main(void)
{
    if (begin() != NPRED_OK) {
        return 1;
    }
    for (int k = 0; k < 40; k++) {
        on_timer();
    }
}
"""


def test_the_page_s_main_loop_runs_as_python_does(tmp_path):
    page = (HERE.parent / "docs" / "deployment.md").read_text()
    (example,) = (text.split("```")[0] for text in page.split("```C\n")[1:] if "on_timer" in text.split("```")[0])
    python, rng = controller(PAPER, u0=[0.002]), np.random.default_rng(6)
    t = 1.0 + np.cumsum(DT * rng.uniform(0.7, 1.3, 40))
    samples = np.column_stack([rng.uniform(0.02, 0.04, 40), rng.uniform(29, 31, 40), t - 0.004])
    samples[rng.random(40) < 0.2, 2] = 0.0
    samples[0, 2], t[39] = t[0], t[39] + 0.7  # a pause
    samples[39, 2] = 0.0
    expected, held, lost = [], np.array([0.002]), None
    for k, (*X, taken) in enumerate(samples):
        U = python.step(X if taken else None, t=t[k], sampled_at=taken or None, applied=lost).copy()
        lost, held = (held, held) if k in (0, 7) else (None, U)
        expected += [U[0]] if python.status.age <= 0.5 else [U[0], "warn"]
    calls, rows = (
        ", ".join(map(repr, t.tolist())),
        ", ".join(f"{{{a!r}, {b!r}, {c!r}}}" for a, b, c in samples.tolist()),
    )
    library(CASES["one input"](), tmp_path)
    (tmp_path / "rig.h").write_text(example.split("/* ")[1].split(" */")[0])
    (tmp_path / "main.c").write_text(example + RIG.replace("CALLS", calls).replace("SAMPLES", rows))
    command = ["gcc", *FLAGS, "-Wno-missing-prototypes", "main.c", "npred.c", "-o", "main", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=120)
    printed = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True, timeout=60).stdout.split()
    assert printed[-1] == expected[-1] == "warn" and len(printed) == 41
    np.testing.assert_allclose(np.array(printed[:-1], dtype=float), expected[:-1], rtol=1e-11)


@pytest.mark.parametrize(("off", "same"), [(0.95e-6, True), (1.5e-6, False)])
def test_times_a_millionth_of_a_step_off_are_on_the_clock_and_others_are_not(tmp_path, off, same):
    """Of calls and of samples, as npred.controller has them."""
    one = controller(MOTOR)
    regular, called, sampled, run, again = one.fresh(), one.fresh(), one.fresh(), *(
        InC(library(one, tmp_path), MOTOR) for _ in range(2)
    )  # fmt: skip
    for k in range(20):
        X, t = np.array([0.5, 1.0 + 0.1 * k]), k * DT * (1 + off if k == 9 else 1)
        U = regular.step(X, t=k * DT, sampled_at=(k - 3) * DT).copy()
        at = called.step(X, t=t, sampled_at=t - 3 * DT).copy(), sampled.step(X, t=k * DT, sampled_at=(k - 3 - off) * DT)
        in_c = run.step_at(t, X, t - 3 * DT), again.step_at(k * DT, X, (k - 3 - off) * DT)
        assert all((code, U_c.tolist()) == (0, other.tolist()) for (code, U_c), other in zip(in_c, at, strict=True))
    assert (at[1] == U).all() == same
