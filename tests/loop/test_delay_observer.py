"""The observers of the delay: it is found from any start, under noise, a wrong model, a disturbance, a jump."""

from dataclasses import replace

import numpy as np
import pytest
from follower import Follower, follower
from hypothesis import given
from hypothesis import strategies as st

import npred
from npred.base.errors import ConfigError
from npred.estimation.delay_observer import NUMBERS
from npred.kernels.kernel import skeleton
from npred.loop import engine
from npred.loop.measurement import Measurement
from npred.plants import Plant
from npred.prediction.delays import problem

PLANT = npred.plant("activator_repressor")
FEW = 20.0  # samples that the window has at least
RK4 = npred.predictor(PLANT, "rk4", nx=51)
LAW = npred.DelayObserver(bounds=(0.1, 4.0))
DELAYS, STARTS = np.meshgrid([0.83, 1.0, 1.234, 1.37, 1.5], [0.3, 0.5, 1.0, 1.5, 2.0, 3.5], indexing="ij")


def loops(D=DELAYS, D_hat=STARTS, **changes):
    settings = {"X0": [0.03, 30.0], "t_end": 60.0, "dt": 0.01, "adaptation": LAW, "actuator": "history"} | changes
    return npred.simulate(PLANT, RK4, D=D, D_hat=D_hat, **settings)


def radius(run):
    """The largest distance from the equilibrium over the last 5 s."""
    return np.abs(run.X[..., -500:, :] - PLANT.equilibrium).max()


def error(run, D=DELAYS):
    """The largest error of the estimate from 10 s on."""
    return np.abs(run.D_hat[..., 1000:] - np.asarray(D)[..., None]).max()


def test_every_start_finds_the_delay_and_ends_at_the_point():
    run = loops()
    assert (run.escaped < 0).all()
    assert radius(run) < 1e-9 and error(run) < 0.01


def test_the_papers_law_fed_with_its_own_commands_loses_some_of_them():
    """What the observers are for: the law needs the measured actuator state."""
    run = loops(D_hat=STARTS, adaptation=npred.DelayAdaptation(1000.0, 1.0, (0.1, 4.0)))
    assert np.mean(np.abs(run.X[..., -500:, :] - PLANT.equilibrium).max(axis=(-1, -2)) > 0.1) > 0.2


WRONG = npred.plant("activator_repressor", **{name: 1.03 * PLANT.parameters[name] for name in ("K1", "K2", "Ka", "Kb")})


@pytest.mark.parametrize(
    ("reality", "largest"),
    [
        ({"measurement": Measurement(relative_noise=0.03)}, 0.02),
        ({"truth": WRONG}, 0.02),
        ({"disturbance": lambda t: [0.002 * np.sin(0.7 * t)]}, 0.05),
        ({"measurement": Measurement(period=0.1, jitter=0.3, relative_noise=0.01)}, 0.05),
    ],
    ids=["noise", "model", "disturbance", "sampled"],
)
def test_the_estimate_holds_in_a_real_loop(reality, largest):
    run = loops(**reality)
    assert (run.escaped < 0).all() and np.abs(run.X[..., -500:, :] - PLANT.equilibrium).max() < 1.5
    assert error(run) < largest


def test_a_delay_that_drifts_or_jumps_loses_no_loop():
    for D in (lambda t: 1 + 0.3 * np.sin(2 * np.pi * t / 60), lambda t: 1.0 if t < 30 else 1.5):
        assert radius(loops(D=D, D_hat=STARTS[0])) < 1e-5


def test_a_jump_is_found_where_the_commands_never_rest():
    """An arm that follows a trajectory tells its delay all the time."""
    arm = npred.plant("planar_arm2")
    law = npred.DelayObserver(bounds=(0.1, 1.0))
    run = npred.simulate(
        arm, npred.predictor(arm, "rk4", nx=51), D=lambda t: 0.3 if t < 15 else 0.5, D_hat=[0.6, 0.2],
        X0=arm.target(0.0) + 0.1, t_end=30.0, dt=0.01, adaptation=law, actuator="history", u0=[0.0, 0.0],
    )  # fmt: skip
    before, after = run.D_hat[:, 1400], run.D_hat[:, 2200:]
    assert np.abs(before - 0.3).max() < 0.01 and np.abs(after - 0.5).max() < 0.02


@pytest.mark.parametrize(
    "reality",
    [
        {"measurement": Measurement(relative_noise=0.01)},
        {"measurement": Measurement(relative_noise=0.01, period=0.05)},
        {"disturbance": lambda t: [0.05 * np.sin(0.7 * t)]},
    ],
    ids=["noise", "sampled", "disturbance"],
)
def test_such_a_jump_is_found_in_seconds_in_a_real_loop_too(reality):
    plant = follower()
    run = npred.simulate(
        plant, npred.predictor(plant, "rk4", nx=21), D=lambda t: 0.5 if t < 30 else 0.8, D_hat=[0.2, 1.0], X0=[0.1],
        t_end=36.0, dt=0.01, adaptation=npred.DelayObserver(bounds=(0.05, 2.0)), actuator="history", **reality,
    )  # fmt: skip
    assert np.abs(run.D_hat[:, 1000:3000] - 0.5).max() < 0.025 and np.abs(run.D_hat[:, 3500:] - 0.8).max() < 0.05


@pytest.mark.parametrize(
    ("name", "bounds", "D", "D_hat", "X0", "largest"),
    [
        ("chemostat", (0.8, 2.2), [1.0, 1.4, 1.6, 1.9], [1.2, 1.8], [2.0, 2.0], 0.01),
        ("scalar", (0.1, 2.0), [0.3, 1.0, 1.3], [0.2, 1.5], [0.8], 0.01),
        ("cart_pole", (0.04, 0.5), [0.1, 0.2, 0.3], [0.05, 0.4], [0.2, 0.1, 0.1, 0.1], 0.01),
    ],
)
def test_other_plants_too(name, bounds, D, D_hat, X0, largest):
    plant = npred.plant(name)
    D, D_hat = np.meshgrid(D, D_hat)
    run = npred.simulate(
        plant, npred.predictor(plant, "rk4", nx=51), D=D, D_hat=D_hat, X0=X0, t_end=60.0, dt=0.01,
        adaptation=npred.DelayObserver(bounds=bounds), actuator="history",
        outlier_limit=None,  # cart_pole's first commands are so large that a model with a wrong delay refuses samples
    )  # fmt: skip
    assert np.abs(run.X[..., -500:, :] - plant.equilibrium).max() < 1e-6
    assert np.abs(run.D_hat[..., -1] - D).max() < largest


@pytest.mark.slow
def test_the_map_keeps_every_cell():
    """13 delays by 9 first estimates, the actuator not measured: more than the paper's law keeps with it measured."""
    D, D_hat = np.meshgrid(np.linspace(0.25, 3.25, 13), np.linspace(0.25, 3.75, 9), indexing="ij")
    run = loops(D=D, D_hat=D_hat, t_end=100.0)
    assert (np.abs(run.X[..., -500:, :] - PLANT.equilibrium).max(axis=(-1, -2)) < 1e-6).all()


class CalledFollower:
    """The follower behind functions that are called, not traced."""

    traced = False
    states, inputs, parameters, box = Follower.states, Follower.inputs, Follower.parameters, Follower.box
    f = lambda X, u, t, p: p.a * X + u

    def kappa(X, t, p):
        r, slope = p.A * np.sin(p.w * t), p.A * p.w * np.cos(p.w * t)
        return (slope - p.a * X[:, 0] - p.c * (X[:, 0] - r))[:, None]

    V = lambda X, t, p: (X[:, 0] - p.A * np.sin(p.w * t)) ** 2
    reference = lambda t, p: (p.A * np.sin(p.w * t))[:, None]


SPARSE = Measurement(
    relative_noise=0.01, period=0.2, jitter=0.5, delay=0.05, drop=0.2
)  # each loop has samples of its own


@pytest.mark.parametrize("measurement", [None, Measurement(relative_noise=0.01, period=0.05, delay=0.02), SPARSE])
def test_a_plant_that_is_called_has_the_estimate_of_its_traced_twin(measurement):
    runs = [
        npred.simulate(
            plant, npred.predictor(plant, "heun", nx=5), D=0.5, D_hat=[0.2, 0.9], X0=[0.1], t_end=3.0, dt=0.01,
            adaptation=npred.DelayObserver(bounds=(0.05, 1.0), candidates=20), actuator="history",
            measurement=measurement,
        )
        for plant in (follower(), npred.plants.make("called", CalledFollower))
    ]  # fmt: skip
    assert np.abs(runs[0].D_hat[:, -1] - 0.5).max() < (0.1 if measurement is SPARSE else 0.02)
    np.testing.assert_allclose(runs[1].D_hat, runs[0].D_hat, rtol=1e-8)
    np.testing.assert_allclose(runs[1].X, runs[0].X, rtol=1e-8, atol=1e-11)


SCALAR = npred.plant("scalar")


def sampled(measurement, D=1.33, D_hat=0.892, X0=(1.0,), **changes):
    """Loops of the scalar plant, whose estimate used to lock onto the sampling period."""
    settings = {"t_end": 30.0, "dt": 0.01, "adaptation": npred.DelayObserver(bounds=(0.1, 2.0)), "actuator": "history"}
    rk4 = npred.predictor(SCALAR, "rk4", nx=21)
    return npred.simulate(SCALAR, rk4, D=D, D_hat=D_hat, X0=X0, measurement=measurement, **settings | changes)


@pytest.mark.parametrize(
    "measurement",
    [
        Measurement(relative_noise=0.005, period=0.2),
        Measurement(relative_noise=0.005, period=0.25),
        Measurement(relative_noise=0.005, period=0.3),
        Measurement(relative_noise=0.005, period=0.3, delay=0.17),
        Measurement(relative_noise=0.005, period=0.2, delay=0.3),
    ],
)
def test_the_estimate_does_not_lock_onto_the_sampling_period(measurement):
    """Between samples the state is predicted with commands that are read at D_hat, which such data would confirm."""
    run = sampled(measurement)
    assert np.abs(run.D_hat[500:] - 1.33).max() < 0.06 and np.abs(run.X).max() < 3 and np.abs(run.X[-100:]).max() < 1e-3


def test_noise_in_few_samples_looks_like_no_jump():
    """Two samples a second: a window of one second would hold two, and their errors differ by more than RISES."""
    sensors = Measurement(relative_noise=0.02, period=0.5, seed=3)
    run = loops(D_hat=STARTS, measurement=sensors, outlier_limit=None, t_end=40.0)  # no other sample is refused
    assert np.abs(run.X[..., -500:, :] - PLANT.equilibrium).max() < 1.1
    assert error(run) < 0.5


def test_loops_with_different_arrival_times_do_not_touch_each_other():
    sparse, starts = replace(SPARSE, seed=4), [0.5, 0.892, 1.5]
    together = sampled(sparse, D_hat=starts, t_end=6.0)
    for i, D_hat in enumerate(starts):
        alone = sampled(replace(sparse, first=i), D_hat=D_hat, t_end=6.0)
        np.testing.assert_array_equal(together.D_hat[i], alone.D_hat)
        np.testing.assert_array_equal(together.X[i], alone.X)


def test_a_sample_each_step_is_the_state_itself():
    exact, each = sampled(None, t_end=6.0), sampled(Measurement(period=0.01), t_end=6.0)
    np.testing.assert_allclose(each.D_hat, exact.D_hat, rtol=0, atol=1e-9)
    np.testing.assert_allclose(each.X, exact.X, rtol=0, atol=1e-9)


class Square:
    """X' = X² + U leaves the finite numbers from X(0) = 5 before the first command acts."""

    states, inputs, guess, box = ("X",), ("U",), (0.0,), {"X": (-1.0, 1.0)}
    f = lambda x, u, t, p, M: [x.X**2 + u.U]
    kappa = lambda x, t, p, M: [-x.X - x.X**2]


def test_a_loop_that_is_lost_stops_no_other_estimate():
    plant = npred.plants.Plant("square", Square)

    def estimates(X0):
        return npred.simulate(
            plant, npred.predictor(plant, "rk4", nx=11), D=0.4, D_hat=0.2, X0=X0, t_end=3.0, dt=0.01,
            adaptation=npred.DelayObserver(bounds=(0.1, 1.0)), actuator="history",
        ).D_hat  # fmt: skip

    np.testing.assert_array_equal(estimates([[5.0], [0.5]])[1], estimates([0.5]))
    assert abs(estimates([0.5])[-1] - 0.4) < 0.02


def of_lanes(arguments, call, n, count):
    """A function of candidates.h, called for each lane, of n numbers that are compared and one input."""
    body = f"    const Bank b = bank(d, law, memory);\n    for (int l = 0; l < d.lanes; l++) {call};\n"
    kernel = problem.build("of_lanes", arguments, body)
    return replace(kernel, before=(skeleton("candidates.h"),), sizes=(n, 1), work=lambda *_: count)


@pytest.mark.parametrize("omega", [8.0, 0.75, 0.2, 0.0])
def test_the_gains_over_a_gap_place_the_poles_of_the_observer_s_errors(omega):
    """Of x and d, for a gap of T seconds, where those of s² + L s + L omega = 0 are in continuous time."""
    law = npred.DelayObserver(L=3.0, omega=omega, memory=5.0, window=1.0, bounds=(0.1, 2.0))
    (_, settings, size), steps, dt, gain = law.observer(SCALAR, 0.01), 30, 0.01, np.empty((4, 2))
    memory = np.ones((size, 2))
    memory[-1] = steps - 1.0  # the gap
    gains = of_lanes("dt, X, law, &memory, &gain", "gains(d, &b, l, X[l], dt, law, gain)", 1, 0)
    gains(dt, np.array([[1.0, np.nan]]), settings, memory, gain)
    T, (inject, push) = steps * dt, gain[:2, 0]
    error_of_both = [[1 - inject, (1 - inject) * T], [-push, 1 - push * T]]
    roots = np.roots([1.0, 3.0, 3.0 * omega]).astype(complex)
    np.testing.assert_allclose(np.poly(error_of_both), np.poly(np.exp(roots * T)).real, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(gain[2:, 0], [1 - np.exp(-1 / FEW / 5), np.exp(-1 / FEW)], rtol=1e-9)
    assert gain[:, 1].tolist() == [0.0, 0.0, 0.0, 1.0] and memory[-1].tolist() == [0.0, steps]
    assert memory[-3].tolist() == [1 + 200 / 2 / FEW, 1.0]  # the steps that the sample counts for: 200 are two windows


def test_the_observers_of_a_loop_touch_those_of_no_other():
    """Any memory, gap and sample: each lane of many ends as it does alone, also the last ones, past a full block."""
    rng, lanes = np.random.default_rng(0), 70
    kernel, settings, size = LAW.observer(PLANT, 0.01)
    memory, X = rng.uniform(0.5, 1.5, (size, lanes)), rng.uniform(0.5, 1.5, (2, lanes))
    memory[-1], X[:, 2] = np.arange(lanes), np.nan
    held, D_hat = rng.uniform(0.5, 1.5, (500, 1, lanes)), rng.uniform(0.5, 1.5, lanes)

    def after(kept):
        parts = [np.ascontiguousarray(a[..., kept]) for a in (X, held, memory, D_hat)]
        kernel(900, 0.01, *parts[:2], 0.0, PLANT.p, settings, *parts[2:])
        return np.vstack(parts[2:])

    together = after(np.arange(lanes))
    for lane in (1, 2, 5, 65, 69):
        np.testing.assert_allclose(after([lane])[:, 0], together[:, lane], rtol=1e-9)


@pytest.mark.parametrize("plant", [follower(), npred.plants.make("called", CalledFollower)], ids=["traced", "called"])
def test_the_observers_of_a_loop_begin_with_its_own_first_sample(plant):
    """Whatever the others do: the second loop has its first sample at the step 3."""
    kernel, settings, size = npred.DelayObserver(bounds=(0.05, 1.0)).observer(plant, 0.01)
    X, held = np.random.default_rng(0).uniform(0.5, 1.5, (9, 1, 2)), np.zeros((200, 1, 2))
    X[:3, :, 1] = np.nan

    def after(kept, steps):
        memory, D_hat = np.full((size, len(kept)), np.nan), np.full(len(kept), 0.5)
        for k in steps:
            sample, commands = (np.ascontiguousarray(a[..., kept]) for a in (X[k], held))
            kernel(k, 0.01, sample, commands, 0.01 * k, plant.p, settings, memory, D_hat)
        return np.vstack([memory, D_hat])

    together = after([0, 1], range(9))
    np.testing.assert_array_equal(together[:, :1], after([0], range(9)))
    np.testing.assert_array_equal(together[:, 1:], after([1], range(3, 9)))
    assert np.isfinite(together).all()


class Waved:
    """X' = U - X + 3 cos 9t."""

    states, inputs = ("X",), ("U",)
    f = lambda x, u, t, p, M: [u.U - x.X + 3 * M.cos(9 * t)]
    kappa = lambda x, t, p, M: [M.sin(3 * t) - x.X]


def test_the_observer_of_the_true_delay_follows_a_plant_of_time_to_rounding():
    """Its steps are Heun's, as those of the plant here: 8 steps of delay, the commands held."""
    plant, dt, late = Plant("waved", Waved), 0.05, 8
    law = npred.DelayObserver(bounds=(0.1, 1.0))
    at = np.rint(law.thetas(dt) / dt).tolist().index(late)
    controller = npred.controller(plant, npred.predictor(plant, "rk4", 11), law, dt, D_hat=0.7, actuator="history")
    X, sent = 0.2, [0.0] * late
    for k in range(100):
        sent.append(controller.step([X])[0])
        assert np.ravel(controller.memory.signals.observer)[at] == pytest.approx(X, abs=1e-12)
        first = sent[k] - X + 3 * np.cos(9 * k * dt)
        second = sent[k] - (X + dt * first) + 3 * np.cos(9 * (k + 1) * dt)
        X += dt / 2 * (first + second)


def test_samples_that_come_late_are_compared_at_the_time_when_they_were_taken():
    """A wave of nine radians a second, 0.3 s late."""
    plant = Plant("waved", Waved)
    run = npred.simulate(
        plant, npred.predictor(plant, "rk4", nx=11), D=0.4, D_hat=[0.2, 0.8], X0=[0.2], t_end=10.0, dt=0.01,
        adaptation=npred.DelayObserver(bounds=(0.1, 1.0)), actuator="history", measurement=Measurement(delay=0.3),
    )  # fmt: skip
    assert np.abs(run.D_hat[:, 300:] - 0.4).max() < 0.02


def test_a_loop_at_rest_keeps_its_estimate():
    """No error, no level, and nothing to divide by; from 2 s on a push moves the loop, and the delay is found."""
    settings = {"D": 0.5, "D_hat": 0.9, "X0": [0.0], "t_end": 6.0, "dt": 0.01, "actuator": "history"}
    plant, law = npred.plant("scalar"), npred.DelayObserver(bounds=(0.05, 1.0))
    run = npred.simulate(
        plant,
        npred.predictor(plant, "rk4", nx=11),
        adaptation=law,
        disturbance=lambda t: [float(2 < t < 2.5)],
        **settings,
    )
    assert (run.D_hat[:200] == 0.9).all() and abs(run.D_hat[-1] - 0.5) < 0.1


def test_a_disturbance_at_rest_replaces_no_transient():
    """In five minutes: it drives the commands, and such of another delay explain the state better than the right."""
    run = loops(D=1.234, D_hat=STARTS[0], disturbance=lambda t: [0.002 * np.sin(0.7 * t)], t_end=300.0, every=10)
    assert np.abs(run.D_hat[:, 100:] - 1.234).max() < 0.05


def after_sample(lasting, recent, D_hat, X=(1.0,), calls=9.0):
    """The estimate and the memory after a sample of candidates 0.1, 0.2, … s with these sums (K,) or (K, n)."""
    count, n = len(lasting), len(X)
    memory, estimate = sampled_by(lasting, recent, D_hat, X, calls)
    return estimate, memory[count * (n + 1) :]


def remembered(lasting, recent, X=(1.0,), calls=9.0, told=100.0, age=0.0, white=0.05):
    """The settings, and the memory of candidates 0.1, 0.2, … s with these sums, of a leak of 0.01 a sample."""
    count, n = len(lasting), len(X)
    settings = [count, n, 0, 0.0, 0.0, 0.01, 0.9, 5.0, 0.1, 0.9]
    assert len(settings) == NUMBERS
    law = np.array([*settings, *np.zeros(count), *np.linspace(0.1, 0.1 * count, count)])
    sums = np.ravel([lasting, recent])
    lanes = [told, white, age, calls, 1.0, 0.0]
    return law, np.concatenate([np.zeros(count * (n + 1)), sums, np.ones(3 * n), np.zeros(2 * n), lanes])[:, None]


def sampled_by(lasting, recent, D_hat, X, calls):
    """The whole memory and the estimate after such a sample."""
    law, memory = remembered(lasting, recent, X, calls)
    estimate, gain = np.array([D_hat]), np.array([[0.0], [0.0], [0.01], [0.9]])
    call = "choose(d, &b, l, X, gain, law, work, D_hat)"
    choose = of_lanes("X, law, &memory, gain, &D_hat", call, len(X), len(lasting))
    choose(np.array(X)[:, None], law, memory, gain, estimate)
    return memory[:, 0], estimate[0]


def chosen(sums, D_hat, X=(1.0,)):
    """The estimate where a tenth of the squared errors (K,) or (K, n) is that of the window."""
    return after_sample(sums, np.array(sums) / 10, D_hat, X)[0]


def restarts(D_hat, recent=(9.0, 9.0, 9.0, 1.5, 9.0, 9.0, 9.0, 9.0), calls=9.0):
    """Whether the memory starts again from the window; then its units do too."""
    _, memory = after_sample([2.0] * 8, recent, D_hat, calls=calls)
    found = memory[:8].tolist()
    assert found in (list(recent), [2.0] * 8) and memory[16] == pytest.approx(min(found))
    assert memory[17] == pytest.approx(0.99 * (1.0 if calls > 5 else min(recent)) + 0.01 * min(recent))  # it moved once
    return found == list(recent)


def test_the_memory_starts_again_where_the_best_candidate_is_none_of_those_at_the_estimate():
    """The nearest one and its neighbours, and in the window another has errors a fourth of theirs: the delay jumped."""
    far = {
        0.2: True,
        0.249: True,
        0.251: False,
        0.3: False,
        0.4: False,
        0.5: False,
        0.549: False,
        0.551: True,
        0.8: True,
    }
    assert {D_hat: restarts(D_hat) for D_hat in far} == far
    assert [restarts(0.8, calls=calls) for calls in (4.9, 5.1)] == [False, True]  # not within two windows of the start
    for errors, expected in ((3.9, False), (4.1, True)):  # times their level
        assert restarts(0.8, [errors] * 3 + [1.0] + [errors] * 4) is expected
    assert not restarts(0.8, [3.0] * 3 + [0.1] + [3.0] * 4)  # the best one's are small, and the others usual


@pytest.mark.parametrize(("share", "pace"), [(0.02, 0.4), (0.06, 1.0)])
def test_the_pace_of_the_memory_is_what_the_window_tells_of_what_it_tells(share, pace):
    """Twice w / W, 1 at most, both sums over their forgetting times, 10 and 100 samples; a level rises by 4 at most."""
    lasting, recent = np.full(8, 500.0), np.full(8, 500.0 * share)
    memory = after_sample(lasting, recent, 0.5)[1]
    assert memory[-2] == pytest.approx(pace) and memory[17] == pytest.approx(1 + 0.01 * 3)


@pytest.mark.parametrize("size", [1e6, -1e6])
def test_errors_of_rounding_in_a_large_state_choose_no_candidate(size):
    sums = np.array([[9.0, 1e-15], [9.0, 9e-15], [1.0, 9e-15], [9.0, 9e-15]])
    assert chosen(sums, 0.1, (1.0, size)) == pytest.approx(0.3, abs=1e-3)


def test_the_estimate_stays_within_the_bounds_where_the_last_candidate_is_beyond_them():
    assert chosen([*[9.0] * 9, 1.0], 0.5) == 0.9


def test_a_candidate_that_left_the_finite_numbers_does_not_count():
    """An observer driven by other commands than the plant may diverge."""
    assert chosen([np.nan, 8.0, 1.0, 3.0], 0.1) == pytest.approx(0.3 + 0.05 * 5 / 9)


def test_candidates_are_whole_control_steps_apart_and_reach_the_bounds():
    for bounds, dt in (((0.1, 4.0), 0.005), ((0.1, 0.13), 0.01), ((0.5, 0.5), 0.01)):
        thetas = npred.DelayObserver(bounds=bounds).thetas(dt)
        assert 3 <= len(thetas) <= 82
        np.testing.assert_allclose(thetas / dt, np.rint(thetas / dt))
        assert thetas[0] == pytest.approx(bounds[0]) and thetas[-1] >= bounds[1] - 1e-9


def test_settings_and_plants_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match="expected at least 3 candidates, got 2"):
        npred.DelayObserver(candidates=2)
    with pytest.raises(ConfigError, match="expected L, memory, window > 0"):
        npred.DelayObserver(memory=0.0)
    with pytest.raises(ConfigError, match="expected a loop that runs its observers"):
        LAW.rate(PLANT, np.zeros((1, 2)), np.zeros((1, 5, 1)), np.zeros((1, 5, 2)), np.ones(1), 0.0)


def test_of_candidates_that_are_as_good_the_estimate_is_the_nearest():
    """It stays within half a spacing of one of them; a single best one has the minimum of a parabola."""
    first, last, single = [5, 1, 1.00005, 1, 1, 5], [5, 1.00005, 1.00005, 1.00005, 1, 5], [9.0, 5.0, 1.0, 2.0, 6.0, 9.0]
    expected = {0.9: 0.5, 0.05: 0.2, 0.42: 0.42, 0.549: 0.549, 0.56: 0.5}
    for tied in (first, last):
        assert {D_hat: chosen(tied, D_hat) for D_hat in expected} == pytest.approx(expected)
    for best, sums in ((0.2, single[1:]), (0.3, single), (0.5, [9.0, 9.0, *single[:4]])):
        assert chosen(sums, 0.9) == pytest.approx(best + 0.1 * 3 / 10)  # the parabola through (-1, 5), (0, 1), (1, 2)


def spread(D_hat, lasting, **told):
    law, memory = remembered(lasting, lasting, **told)
    return engine.spreads(1, law, memory, np.array([D_hat]))[0]


def test_the_spread_is_that_of_d_hat_and_the_candidates_which_noise_may_make_of_the_best():
    """Of 100 samples such is a difference of 4 variances / 100, where the errors of the best one are white."""
    costs = 1 + np.array([9.0, 0.3, 0.05, 0.03, 0.0, 0.02, 0.05, 9.0])
    assert spread(0.5, costs) == pytest.approx(0.1)  # of .4, .5, .6
    assert spread(0.5, costs, told=1000.0) == pytest.approx(0.025)  # a quarter of a candidate, at least
    assert spread(0.5, costs, told=10.0) == pytest.approx(0.25)  # from .2 to .7
    assert spread(0.5, costs, told=0.0) == pytest.approx(0.35)  # from .1 to .8
    assert spread(0.8, costs) == pytest.approx(0.2)  # from .4 to D_hat
    assert spread(0.14, costs) == spread(0.87, costs) == pytest.approx(0.8)  # at a bound: nothing is known


@given(
    st.floats(0.2, 0.8), st.lists(st.floats(1.0, 20.0), min_size=8, max_size=8), st.floats(0.0, 1e4), st.floats(0, 1e6)
)
def test_the_spread_grows_with_the_age_of_what_the_samples_told_and_falls_with_their_number(D_hat, costs, told, age):
    now, old, oldest = (spread(D_hat, costs, told=told, age=a) for a in (0.0, age, 1e9))
    assert now == spread(D_hat, costs, told=told, age=100.0) <= old <= oldest == pytest.approx(0.4)
    assert spread(D_hat, costs, told=2 * told) <= now
