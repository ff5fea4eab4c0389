"""An unknown delay of a plant whose state and offset are estimated from outputs: it is found, or that is said."""

import ctypes

import numpy as np
import pytest
from c_controllers import InC, library, needs_gcc

import npred
from npred import diagnosis
from npred.base import progress
from npred.base.errors import DivergedError
from npred.estimation.observers import EKF, Luenberger


class Neutral:
    """The pH of a tank, which a slow sensor measures; base comes through a long line."""

    states, inputs, outputs, parameters = ("w", "e"), ("q",), ("pH",), {"aim": 7.0}
    box, guess, input_bounds = {"w": (-1.0, 1.0), "e": (4.5, 9.5)}, (0.0, 7.0), ((0.0, 2.0),)

    def f(x, u, t, p, M):
        r = x.w / 0.3
        pH = 7 + 2 * M.log(r + M.sqrt(r * r + 1)) / 2.302585
        return [(200 * u.q - 160 - (20 + u.q) * x.w) / 60, (pH - x.e) / 0.15]

    output = lambda x, t, p, M: [x.e]
    setpoint = lambda x, t, p, M: [x.e - p.aim]


TANK = npred.plant(Neutral, kappa="lqr")
HEUN = npred.predictor(TANK, "heun", nx=31)
AIMS = {"aim": ([1.0, 8.0], [8.0, 6.5])}


def loop(observer=None, **changes):
    parts = {"D": 0.5, "D_hat": 0.65, "X0": [0.0, 7.0], "t_end": 14.0, "dt": 0.01, "actuator": "history"}
    parts |= {"u0": "equilibrium", "setpoints": AIMS, "measurement": npred.Measurement(noise=0.02, seed=7)}
    parts |= {"adaptation": npred.DelayObserver(bounds=(0.2, 1.0)), "progress": False}
    return npred.simulate(TANK, HEUN, observer=observer or EKF(TANK, offset=True), **parts | changes)


def settles(run):
    return np.abs(run.X[-200:, 1] - 6.5).max() < 0.1


STARTS = np.array([0.3, 0.65, 0.8])


@pytest.mark.parametrize("kind", [EKF, Luenberger])
def test_the_delay_is_found_from_noisy_outputs_beside_an_estimated_offset(kind):
    for seed in range(3):
        runs = [
            loop(kind(TANK, offset=True), D_hat=D_hat, measurement=npred.Measurement(noise=0.02, seed=seed))
            for D_hat in STARTS
        ]
        assert all(map(settles, runs))
        errors = np.array([abs(run.D_hat[-1] - 0.5) for run in runs])
        assert errors.max() < 0.04 and (errors <= 2 * np.array([run.D_hat_spread for run in runs])).all()
        assert max(run.D_hat_spread for run in runs) < 0.2


@pytest.mark.parametrize(
    "reality",
    [
        {"measurement": npred.Measurement(noise=0.02, period=0.1, jitter=0.3)},
        {"measurement": npred.Measurement(noise=0.02, period=0.05, delay=0.1)},
        {"timing": npred.Timing(jitter=0.3)},
        {"X0": [0.5, 8.5]},
        {"disturbance": lambda t: [0.05 if t > 5 else 0.0]},
        {"D_hat": 0.3, "D": lambda t: 0.5 if t < 3 else 0.8},
    ],
    ids=["rare", "late", "clock", "start", "load", "jump"],
)
def test_it_is_found_in_a_real_loop(reality):
    run, D = loop(**reality), 0.8 if callable(reality.get("D")) else 0.5
    assert settles(run) and abs(run.D_hat[-1] - D) < 0.05


def test_the_candidate_of_the_true_delay_needs_no_correction():
    """Without noise, from the right state, it stays at the plant's to the error of Heun's steps."""
    observer = EKF(TANK, offset=True, X0=[0.0, 7.0])
    law = npred.DelayObserver(bounds=(0.2, 1.0), candidates=9)
    one = npred.controller(TANK, HEUN, law, 0.01, D_hat=0.7, observer=observer, u0="equilibrium")
    run = loop(observer, D_hat=0.7, adaptation=law, t_end=3.0, measurement=npred.Measurement())
    off = []
    for k, X in enumerate(run.X):
        if k == 100:
            one.set(aim=8.0)
        one.step(X[1:])
        off.append(np.abs(one.memory.signals.observer[: 9 * 3, 0].reshape(9, 3)[:, :2] - X).max(axis=1))
    largest = np.max(off, axis=0)
    assert largest[np.isclose(law.thetas(0.01), 0.5)][0] < 1e-3 < 0.02 < np.sort(largest)[1]


def test_at_rest_without_noise_the_estimate_stays_and_its_spread_says_that_nothing_is_known():
    run = loop(D_hat=0.8, setpoints=None, measurement=npred.Measurement(), t_end=4.0)
    assert (run.D_hat == 0.8).all() and run.D_hat_spread == pytest.approx(0.4, rel=0.01)


def test_a_wrong_sample_moves_no_estimate():
    """It counts as six deviations for every candidate."""
    law, observer = npred.DelayObserver(bounds=(0.2, 1.0)), EKF(TANK, offset=True)
    one = npred.controller(TANK, HEUN, law, 0.01, D_hat=0.5, observer=observer, u0="equilibrium")
    rng, estimates = np.random.default_rng(0), []
    for k in range(300):
        one.step([7.0 + 0.02 * rng.standard_normal() + (1e6 if k == 200 else 0.0)])
        estimates.append(one.D_hat)
    assert np.ptp(estimates) == 0 and np.isfinite(one.memory.signals.observer).all()


def test_a_delay_beyond_the_bounds_is_said():
    law, lines = npred.DelayObserver(bounds=(0.2, 0.4)), []
    with progress.listener(lines.append):
        run = loop(D_hat=0.3, adaptation=law, progress=None)
    assert [line for line in lines if "bound" in line] == [
        "simulate: D_hat ended at its bound and the delay may lie outside; widen bounds"
    ]
    assert run.D_hat_spread == pytest.approx(0.2) and "0.4 s ± 0.2" in repr(run)


@pytest.mark.parametrize(("D_hat", "stands"), [(0.1, True), (0.4, True), (0.25, False)])
def test_the_status_says_that_the_estimate_stands_at_its_bound(D_hat, stands):
    plant = npred.plant("scalar")
    rk4 = npred.predictor(plant, "rk4", nx=11)
    for law in (npred.DelayObserver(bounds=(0.1, 0.4)), npred.L1Adaptation(bounds=(0.1, 0.4))):
        one = npred.controller(plant, rk4, law, 0.01, D_hat=D_hat)
        one.step([0.0])
        assert one.status.at_bound == stands
    assert not npred.controller(plant, rk4, None, 0.01, D_hat=D_hat).status.at_bound


def test_an_observer_of_the_delay_does_not_begin_anew_with_that_of_the_state():
    """A jump of the state makes the filter start anew; what outputs told of the delay remains."""
    one = npred.controller(
        TANK, HEUN, npred.DelayObserver(bounds=(0.2, 1.0)), 0.01, D_hat=0.5, observer=EKF(TANK, offset=True)
    )
    for k in range(200):
        one.step([7.0 if k < 100 else 20.0])
    assert one.status.renewed > 0 and one.memory.signals.observer[-6, 0] > 150  # samples that it has counted


class Tanks:
    """Two tanks in a row; the slope of a root at 0 is not finite."""

    states, inputs, outputs, parameters = ("h", "g"), ("q",), ("level",), {"aim": 1.0}
    box, guess, input_bounds = {"h": (0.1, 2.0), "g": (0.1, 2.0)}, (1.0, 1.0), ((0.0, 3.0),)

    f = lambda x, u, t, p, M: [u.q - M.sqrt(x.h), M.sqrt(x.h) - M.sqrt(x.g)]
    output = lambda x, t, p, M: [x.g]
    setpoint = lambda x, t, p, M: [x.g - p.aim]


@needs_gcc
@pytest.mark.parametrize("kind", [EKF, Luenberger])
def test_candidates_that_are_not_finite_start_anew_and_find_the_delay_in_c_too(kind, tmp_path):
    """A sensor gives 0 at first."""
    plant = npred.plant(Tanks, kappa="lqr")
    law, heun = npred.DelayObserver(bounds=(0.1, 1.0)), npred.predictor(plant, "heun", nx=31)
    one = npred.controller(plant, heun, law, 0.01, D_hat=0.5, observer=kind(plant, offset=True), u0="equilibrium")
    X, sent, in_c = np.ones(2), [1.0] * 20, InC(library(one, tmp_path), plant)
    in_c.library.npred_set_aim.argtypes = [ctypes.c_void_p, ctypes.c_double]
    for k in range(1200):
        if k % 400 == 300:
            aim = 1.4 if k % 800 == 300 else 1.0
            one.set(aim=aim)
            assert in_c.library.npred_set_aim(in_c.memory, aim) == 0
        Y, U = [0.0 if k < 6 else X[1]], np.full(1, np.nan)
        code = in_c.code(Y, out=U)
        try:
            sent += [*one.step(Y)]
            assert code == 0 and U[0] == sent[-1]
        except DivergedError:
            sent.append(sent[-1])
            assert code == 2 and k < 6
        X = X + 0.01 * plant.f(X, [sent[-21]])
    assert abs(one.D_hat - 0.2) < 0.03 and np.isfinite(one.memory.signals.observer).all()
    assert in_c.status(1).D_hat == one.D_hat


class Slack(Neutral):
    """A tank whose base hardly moves its pH."""

    f = lambda x, u, t, p, M: [(u.q - 0.8 - x.w) / 60, (7 + x.w - x.e) / 0.15]


@pytest.mark.slow
def test_plants_check_says_whether_outputs_tell_the_delay():
    found = {answer.check: answer for answer in diagnosis.check(TANK, 0.5)}["delay estimate"]
    assert found.verdict == "yes" and found.figures["D_hat_error"] < 0.1
    assert "delay estimate" not in {answer.check for answer in diagnosis.check(npred.plant("scalar"), 0.5)}
    found = {answer.check: answer for answer in diagnosis.check(npred.plant(Slack, kappa="lqr"), 0.5)}["delay estimate"]
    assert found.verdict == "warn" and "the outputs do not tell the delay" in found.text
