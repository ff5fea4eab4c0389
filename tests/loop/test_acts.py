"""Each field of npred.Loop: a loop in which it acts, one in which it cannot and is refused, and a value that is wrong.

A new field fails here until it has all three.
"""

from dataclasses import fields

import numpy as np
import pytest
from slow_cart import Cart

import npred
from npred.base.errors import ConfigError, DivergedError
from npred.loop import acts
from npred.loop.acts import NEEDS

CART, HEAVY = npred.plant(Cart), npred.plant(Cart, drag=0.4)
LATE = npred.plant(type("Late", (Cart,), {"delay": lambda x, t, p, M: 0.2 + 0.02 * M.sin(t)}))
RK4, OF_LATE = npred.predictor(CART, "rk4", 11), npred.predictor(LATE, "rk4", 11)
LOOP = {"plant": CART, "predictor": RK4, "X0": [0.0, 0.1], "D": 0.2, "D_hat": 0.2, "dt": 0.02}
DECLARED = {"plant": LATE, "predictor": OF_LATE, "D": None, "D_hat": None}
OPEN, NO_DELAY, BY_COMMANDS = {"predictor": None}, {"D": 0.0, "D_hat": 0.0}, {"actuator": "history"}
ALONE = {"X0": None, "D": None} | BY_COMMANDS
CLOCK = BY_COMMANDS | {"timing": npred.Timing()}
RARE = CLOCK | {"measurement": npred.Measurement(noise=0.05, period=0.1, delay=0.06, drop=0.5)}
LAW = npred.DelayAdaptation(gamma=5.0, bounds=(0.05, 0.8))

ACTS = {  # by field: two values, and the rest of a loop in which they differ
    "plant": (CART, HEAVY, {"truth": CART, "predictor": "own"}),
    "predictor": (RK4, npred.predictor(CART, "euler", 11), {}),
    "dt": (0.02, 0.01, {}),
    "adaptation": (None, LAW, {"D_hat": 0.4}),
    "D_hat": (0.2, 0.3, {}),
    "input_bounds": (None, [(-0.2, 0.2)], {}),
    "u0": ([0.0], [0.5], {}),
    "actuator": ("measured", "history", {"D_hat": 0.3}),
    "observer": (None, npred.observers.EKF(CART), CLOCK),
    "watchdog": (None, npred.Watchdog(0.1, "zero"), RARE),
    "safety": (None, npred.SafetyFilter(), {}),
    "outlier_limit": (1.0, 0.001, RARE),
    "max_sample_age": (None, 0.06, RARE | {"timing": npred.Timing(jitter=0.4)}),
    "history_length": (0.25, 2.0, ALONE | DECLARED | {"plant": LATE}),
    "D": (0.2, 0.3, {}),
    "X0": ([0.0, 0.1], [0.1, 0.1], {}),
    "measurement": (npred.Measurement(), npred.Measurement(noise=0.01), {}),
    "truth": (None, HEAVY, {}),
    "disturbance": (None, lambda t: [0.1], {}),
    "setpoints": (None, {"aim": ([0.5], [0.2])}, {}),
    "timing": (None, npred.Timing(lost=0.5), BY_COMMANDS),
    "integrator": ("rk4", "euler", {}),
}
REFUSED = {  # by field: a value, the rest of a loop in which it cannot act, and what is said; None: it always acts
    "plant": None, "predictor": None, "dt": None, "X0": None,
    "adaptation": [(LAW, OPEN, "a predictor"), (LAW, DECLARED, "a plant that does not declare")],
    "D_hat": [(0.3, DECLARED, "a plant that does not declare its delay, got Late; give 0 for no prediction"),
              (0.3, ALONE | DECLARED, "a plant that does not declare its delay")],
    "input_bounds": [([(-1.0, 1.0)], OPEN, "a predictor, got None, the open loop; give one, or no input_bounds")],
    "u0": [([0.1], NO_DELAY, "a delay, got D = 0"), ([0.1], ALONE | {"actuator": "measured"}, 'actuator="history"')],
    "actuator": [("history", OPEN, "a predictor")],
    "observer": [(npred.observers.EKF(CART), {}, 'actuator="history", got \'measured\'; give it, or no observer'),
                 (npred.observers.EKF(LATE), DECLARED | BY_COMMANDS, "a plant that does not declare its delay")],
    "watchdog": [(npred.Watchdog(0.1), {}, 'actuator="history"'),
                 (npred.Watchdog(0.1), DECLARED | BY_COMMANDS, "a plant that does not declare its delay")],
    "safety": [(npred.SafetyFilter(), OPEN, "a predictor"),
               (npred.SafetyFilter(delay=0.1), {}, 'actuator="history"'),
               (npred.SafetyFilter(), ALONE | {"actuator": "measured"}, 'actuator="history"')],
    "outlier_limit": [(2.0, {}, 'actuator="history"'), (None, OPEN, "a predictor")],
    "max_sample_age": [(0.1, {}, 'actuator="history"'), (0.1, BY_COMMANDS, "samples that may come late"),
                       (0.1, CLOCK, "samples that may come late")],
    "history_length": [(1.0, {}, "a controller alone"), (1.0, ALONE | {"actuator": "measured"}, 'actuator="history"')],
    "D": [(0.2, ALONE, "a simulated loop"), (0.2, DECLARED, "a plant that does not declare its delay")],
    "measurement": [(npred.Measurement(0.1), OPEN, "a predictor"), (npred.Measurement(0.1), ALONE, "a simulated loop"),
                    (npred.Measurement(observer=lambda *_: 0), CLOCK, "no observer in Python on a clock, got one")],
    "truth": [(HEAVY, ALONE, "a simulated loop")],
    "disturbance": [(lambda t: [0.1], ALONE, "a simulated loop")],
    "setpoints": [({"aim": ([0.5], [0.2])}, OPEN, "a predictor"),
                  ({"aim": ([0.5], [0.2])}, ALONE, "a simulated loop")],
    "timing": [(npred.Timing(), {}, 'actuator="history"'), (npred.Timing(), ALONE, "a simulated loop"),
               (npred.Timing(), DECLARED | BY_COMMANDS, "a plant that does not declare its delay")],
    "integrator": [("euler", ALONE, "a simulated loop")],
}  # fmt: skip
WRONG = {  # by field: values of a wrong type, shape or range
    "plant": ["cart", None], "predictor": ["rk4", OF_LATE], "dt": [0.0, "0.1", [0.1, 0.2], np.inf],
    "adaptation": [1.0, "fast"], "D_hat": [-0.1, "long", np.nan, None], "input_bounds": [[(1.0, 0.0)], 3.0],
    "u0": ["rest", [np.nan], [1.0, 2.0]], "actuator": ["commands", None], "observer": ["ekf"], "watchdog": [0.1],
    "safety": [True], "outlier_limit": ["nonsense", 0.0, -1.0, np.inf], "max_sample_age": [-3, "old", np.nan],
    "history_length": [-1.0, "long"], "D": [-1.0, "long", None], "X0": ["there", [1.0], [np.nan, 0.0]],
    "measurement": [0.1], "truth": ["heavy", npred.plant("scalar"), LATE], "disturbance": [0.1],
    "setpoints": [[0.2], 3, {"aim": 2.0}], "timing": [0.3], "integrator": ["picard", 4],
}  # fmt: skip
FIELDS = [field.name for field in fields(npred.Loop)]
ONLY_ALONE = {"history_length"}


def does(loop):
    """What a loop gives, all that a reader of its record or of its status sees."""
    if loop["predictor"] == "own":
        loop["predictor"] = npred.predictor(loop["plant"], "rk4", 11)
    if loop.get("X0") is None:
        named = {name: value for name, value in loop.items() if name not in ("X0", "D") and value is not None}
        controller, given = npred.controller(**{"adaptation": None, "D_hat": None} | named), []
        for k in range(40):
            try:
                given.append(controller.step([0.01 * k, 0.0]).copy())
            except DivergedError:
                given.append(np.full(1, np.nan))
        return [*given, *map(np.asarray, controller.status)]
    run = npred.simulate(**loop, t_end=1.6, progress=False)
    return [run.U, run.D_hat, run.X, run.P]


def made(loop):
    if loop.get("X0") is None and "X0" in loop:
        named = {name: value for name, value in loop.items() if name not in ("X0", "D") or value is not None}
        return npred.controller(**{"adaptation": None, "D_hat": None} | named)
    return npred.simulate(**loop, t_end=0.1, progress=False)


def test_every_field_is_here():
    assert list(ACTS) == FIELDS and set(FIELDS) == REFUSED.keys() == WRONG.keys() == NEEDS.keys()
    assert all((REFUSED[name] is None) == (NEEDS[name] == ()) for name in FIELDS)


@pytest.mark.parametrize("name", FIELDS)
def test_a_field_acts(name):
    one, other, loop = ACTS[name]
    first, second = (does(LOOP | loop | {name: value}) for value in (one, other))
    assert any(
        a.shape != b.shape or not np.array_equal(a, b, equal_nan=True) for a, b in zip(first, second, strict=True)
    )


@pytest.mark.parametrize(("name", "case"), [(name, case) for name, cases in REFUSED.items() for case in cases or ()])
def test_where_it_cannot_act_it_is_refused(name, case):
    value, loop, words = case
    with pytest.raises(ConfigError) as told:
        made(LOOP | loop | {name: value})
    assert str(told.value).startswith(f"{name}: expected {words}") and "\n" not in str(told.value)


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG.items() for value in values])
def test_what_is_wrong_is_told_in_one_line(name, value):
    rest = (
        ALONE if name in ONLY_ALONE else RARE if name == "max_sample_age" else CLOCK if name == "outlier_limit" else {}
    )
    with pytest.raises(ConfigError) as told:
        made(LOOP | rest | {name: value})
    said = str(told.value)
    assert "expected" in said and "got" in said and "; " in said and "\n" not in said


def test_no_need_is_left_over():
    used = {need for needs in NEEDS.values() for need in needs}
    assert {value for value in vars(acts).values() if isinstance(value, acts.Need)} == used


def test_the_description_itself_is_checked():
    with pytest.raises(ConfigError, match="outlier_limit: expected a real number, got 'nonsense'"):
        npred.Loop(plant=CART, predictor=RK4, outlier_limit="nonsense")
