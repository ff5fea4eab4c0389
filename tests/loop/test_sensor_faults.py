"""A sensor that fails for a time: when it is well again, the controller is as before within D_hat and the time in which
its observer settles, and a state that it saved is one that it takes."""

import contextlib
import json

import numpy as np
import pytest
from faulty_sensors import DT, FAULTS, OBSERVERS, PLANTS, Loop, constant, controller, of_one, settling
from hypothesis import example, given, settings
from hypothesis import strategies as st

import npred
from npred.base.errors import DivergedError
from npred.plants import Plant

ABSURD = ("inf", "-inf", "1e+12", "1e+200", "1e+308")
OTHERS = [name for name in FAULTS if name not in ABSURD]
FAILS = 2.0  # seconds


def recovers(name, kind, fault, watched=True):
    """A loop that is at rest for a second, whose sensor fails, and is well again."""
    bound = PLANTS[name][1] + settling(name, kind)
    loop = Loop(controller(name, kind, watched)).run(1.0).run(FAILS, fault).run(bound + 0.5)
    took = loop.settled(1.0 + FAILS)
    assert took <= bound + DT / 2, f"{took:.2f} s"
    controller(name, kind, watched).restore(json.loads(json.dumps(loop.one.state())))
    return loop


@pytest.mark.parametrize("value", ABSURD)
@pytest.mark.parametrize("watched", [True, False])
@pytest.mark.parametrize("kind", OBSERVERS)
def test_readings_that_no_sensor_gives_are_forgotten(kind, watched, value):
    loop = recovers("chemostat", kind, FAULTS[value](), watched)
    assert loop.one.status.renewed == 0  # such readings are not believed
    assert loop.one.status.refused == (0 if "inf" in value else round(FAILS / DT))


@pytest.mark.parametrize("fault", OTHERS)
@pytest.mark.parametrize("kind", OBSERVERS)
def test_readings_that_may_be_are_forgotten_too(kind, fault):
    """A Luenberger observer knows no spread: it believes a steep ramp, and a sign that changes, until it is lost."""
    if kind == "EKF" or fault not in ("steep ramp", "turned"):
        recovers("chemostat", kind, FAULTS[fault]())


@pytest.mark.parametrize("fault", ["inf", "1e+308", "frozen", "ramp", "burst", "all kinds", "turned", "30"])
@pytest.mark.parametrize("kind", OBSERVERS)
def test_where_one_output_of_two_fails_the_other_one_is_used(kind, fault):
    loop = recovers("chemostat, both", kind, of_one(FAULTS[fault]()))
    assert not any(loop.handed)


@pytest.mark.parametrize("fault", ["inf", "1e+308", "4", "some missing"])
@pytest.mark.parametrize("kind", OBSERVERS)
def test_of_another_plant(kind, fault):
    recovers("van_der_pol", kind, FAULTS[fault]())


@pytest.mark.parametrize("fault", [name for name in FAULTS if name != "nan"])
def test_a_state_that_is_measured_is_believed_again_at_once_or_after_the_delay(fault):
    loop = Loop(controller("van_der_pol", None)).run(1.0).run(FAILS, FAULTS[fault]()).run(1.5)
    assert loop.settled(1.0 + FAILS) <= PLANTS["van_der_pol"][1] + DT / 2
    controller("van_der_pol", None).restore(json.loads(json.dumps(loop.one.state())))


@settings(max_examples=12, deadline=None)
@given(
    name=st.sampled_from(["van_der_pol", "scalar", "chemostat, both"]), kind=st.sampled_from([None, *OBSERVERS]),
    at=st.integers(0, 60), size=st.floats(np.log(0.2), np.log(12.0)), sign=st.sampled_from([-1, 1]),
)  # fmt: skip
@example("van_der_pol", "Luenberger", 100, np.log(5.5), 1)
@example("chemostat, both", None, 33, np.log(1.43), -1)  # the true ones are farther from it than it from them
@example("scalar", None, 31, np.log(0.9999), -1)  # it moves away meanwhile
@example("scalar", "EKF", 0, np.log(4.7), -1)
def test_one_wrong_sample_at_rest_is_forgotten_within_the_delay(name, kind, at, size, sign):
    """The first one, which nothing is known of, any later one; and a Luenberger observer refuses half a range."""
    one = controller(name, kind, watched=False)
    widths = [np.ptp(one.plant.box[state]) / 2 for state in one.plant.states]
    push = sign * np.exp(size) * np.array(one.observer.sizes.dy if one.observer else widths)
    D, loop = one.D_hat, Loop(one).run(at * DT)
    before = one.status.refused
    loop.run(DT, lambda k, Y: Y + push)
    if kind == "Luenberger" and at and np.exp(size) > 1.1:
        assert one.status.refused == before + 1
    assert loop.run(2 * D + 1.0).settled(at * DT) <= D + 2 * DT
    assert one.status.refused <= 2 and one.status.missed == 0


def test_a_filter_that_is_lost_begins_anew_and_says_so():
    """A reading of 6 may be: a filter that begins believes it, and the true ones are then far for as long."""
    loop = Loop(controller("chemostat", "EKF")).run(2.0).run(1.4, constant(6.0))
    assert loop.one.status.renewed == 0 and loop.one.status.refused == 140
    loop.run(0.2, constant(6.0))
    assert loop.one.status.renewed == 1 and loop.one.X_hat[1] == pytest.approx(6.0, abs=0.05)
    loop.run(0.2)
    assert loop.one.status.renewed == 2 and loop.one.X_hat[1] == pytest.approx(loop.X[1], abs=0.05)


def test_one_inf_after_a_pause_is_no_sample():
    """After two samples that were refused, when the filter would begin anew."""
    one = controller("chemostat", "EKF", watched=False)
    for k in range(50):
        one.step([2.0], t=k * DT)
    for t, value in ((0.5, 50.0), (0.51, 50.0), (2.6, np.inf)):
        one.step([value], t=t)
    status = one.status
    assert status.age == pytest.approx(2.11) and status.refused == 2 and np.isfinite(one.X_hat).all()
    one.step([2.0], t=2.61)
    assert one.status.age == 0 and one.status.missed == 0


class Cart:
    """A position, moved by its speed, of which the box says too little."""

    states, inputs = ("p",), ("speed",)
    box, input_bounds = {"p": (-1.0, 1.0)}, ((-1.0, 1.0),)
    f = lambda x, u, t, p, M: [u.speed]
    kappa = lambda x, t, p, M: [-x.p]


def test_a_plant_far_from_the_box_is_believed_in_the_end():
    """Ten times as far after each further delay, and then as well as anywhere."""
    plant, D = Plant("cart", Cart), 0.3
    one = npred.controller(
        plant, npred.predictor(plant, "heun", nx=11), None, DT, D_hat=D, actuator="history", u0=0.0,
        observer=npred.observers.EKF(plant),
    )  # fmt: skip
    loop, ages = Loop(one, [6e3]), []
    for _ in range(200):
        loop.run(DT)
        ages.append(one.status.age)
    first = ages.index(0.0)
    assert first * DT == pytest.approx((1 + 3) * D, abs=2 * DT) and not any(ages[first:])
    assert one.status.renewed == 1 and abs(one.X_hat[0] - loop.X[0]) < 0.01


def estimating(fault, **named):
    """A loop whose delay is estimated, at rest; its state, which the fault hides, and its delay change meanwhile."""
    law = npred.DelayObserver(bounds=(0.05, 0.6), candidates=20)
    loop = Loop(controller("scalar", None, adaptation=law, **named), [0.5]).run(1.5)
    loop.X, loop.line = np.array([0.5]), loop.line + [loop.U] * 15
    return loop.run(2.0, fault).run(3.0)


@pytest.mark.parametrize("value", [1e2, 1e4, 1e6])
def test_an_observer_of_the_delay_forgets_what_was_believed(value):
    loop = estimating(constant(value))
    assert abs(loop.one.D_hat - 0.45) < 0.01 and loop.one.status.D_hat_spread < 0.05


@pytest.mark.parametrize("value", [1e155, 1e300])
def test_an_observer_of_the_delay_begins_anew_where_its_errors_are_not_finite(value):
    loop = estimating(constant(value), outlier_limit=None)
    assert np.isfinite(loop.one.memory.signals.observer).all() and 0 <= loop.one.status.D_hat_spread < 0.3


@pytest.mark.parametrize("value", [1e300, 5e307])
def test_an_absurd_state_leaves_no_rate_of_the_delay_behind(value):
    plant, law = npred.plant("scalar"), npred.L1Adaptation(0.01, bounds=(0.1, 0.6))
    make = lambda: npred.controller(
        plant, npred.predictor(plant, "heun", nx=21), law, DT, D_hat=0.3, actuator="history", outlier_limit=None
    )
    one = make()
    for k in range(20):
        absurd = 5 <= k < 8
        with pytest.raises(DivergedError) if absurd else contextlib.nullcontext():
            one.step([value if absurd else 0.5])
        make().restore(json.loads(json.dumps(one.state())))
    assert one.D_hat == pytest.approx(0.3, abs=0.01)
