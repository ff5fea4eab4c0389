"""From a recording to a controller of that plant, and what is said of a log."""

import numpy as np
import pytest
from recorded import looped, steps
from test_identify import decay

import npred
from npred.identification.alternatives import Alternative, Validation
from npred.identification.estimate import Combination, Parameter
from npred.identification.identified import Findings

CASES = {  # the plant, its true delay, the sampling period, the size of the test signal, the start, the loop's length
    "scalar": (0.4, 0.05, 0.5, [0.8], 15.0),
    "van_der_pol": (0.35, 0.05, 1.0, [1.0, 0.5], 25.0),
    "chemostat": (0.9, 0.1, 0.1, [2.5, 1.6], 60.0),
    "activator_repressor": (0.6, 0.1, 0.05, [0.05, 20.0], 80.0),
    "tank": (0.6, 0.1, 0.3, [0.6], 20.0),
}


class Tank:
    """The tank of the documentation."""

    states, inputs = ("h",), ("q",)
    parameters = {"area": 1.0, "outflow": 0.5, "level": 1.0, "gain": 1.0}
    box, guess = {"h": (0.5, 2.0)}, (1.0,)
    f = lambda x, u, t, p, M: [(u.q - p.outflow * M.sqrt(x.h)) / p.area]
    kappa = lambda x, t, p, M: [p.outflow * M.sqrt(x.h) - p.gain * (x.h - p.level)]
    V = lambda x, t, p, M: (x.h - p.level) ** 2


def made(name: str, **parameters: float) -> npred.plants.Plant:
    return npred.plants.make("tank", Tank, parameters) if name == "tank" else npred.plant(name, **parameters)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_identified_controller_stabilises_the_true_plant(name: str):
    D, period, size, start, t_end = CASES[name]
    model, rng = made(name), np.random.default_rng(3)
    in_f = [key for key in model.parameters if key not in ("c", "level", "gain", "delta") and "_set" not in key]
    truth = {key: model.parameters[key] * (1 + 0.03 * rng.uniform(-1, 1)) for key in in_f}
    real = made(name, **truth)
    shrunk = model.u_equilibrium
    law = lambda x: shrunk + 0.5 * (model.kappa(x) - shrunk)  # half the gain bears the delay
    table = looped(real.f, law, model.equilibrium, steps(500, model.m, 8, 1, size), D, period, 0.01, 1)
    found = npred.identify(model, *table, longest=2.0, free=in_f[:1])
    assert found.identifiable.all() and abs(found.D[0] - D) < period
    controlled = made(name, **found.parameters)
    loop = npred.simulate(
        controlled, npred.predictor(controlled, "rk4", nx=41), D=D, D_hat=float(found.D[0]), X0=start, t_end=t_end,
        dt=period / 10, u0="equilibrium", truth=real,
    )  # fmt: skip
    gap = np.linalg.norm((loop.X - real.equilibrium) / (1 + np.abs(real.equilibrium)), axis=-1)
    assert gap[-1] < 0.1 and gap[-1] < 0.3 * gap[0]


HIGH = 1.5


def said(interval=(0.25, 0.35), as_good=False, behind=None, **changes) -> Findings:
    """Findings of a delay of 0.3 s, of which delays up to 1.5 s were tried."""
    found = {
        "plant": decay(), "D": np.array([0.3]), "early": np.zeros(1), "interval": np.array([interval]),
        "high": np.full(1, HIGH), "period": 0.05, "alternatives": [Alternative(0.2, as_good, False, 0.0, behind)],
        "lagged": np.zeros(1, dtype=bool), "still": np.zeros(1, dtype=bool), "alike": [],
        "recurring": np.full(1, np.inf), "parameters": {}, "assumed": {},
        "combination": None, "inflation": 1.0, "drift": 0.0, "accurate": True, "several": False, "closed": 0.0,
        "validation": Validation({}, None),
    }  # fmt: skip
    return Findings(**found | changes)


@pytest.mark.parametrize(
    ("changes", "known"),
    [
        ({}, True),
        ({"interval": (0.1, 0.1 + 0.49 * HIGH)}, True),
        ({"interval": (0.1, 0.1 + 0.51 * HIGH)}, False),  # half of the range that was tried
        ({"interval": (0.0, 0.04)}, True),  # no delay, up to a sampling period
        ({"interval": (0.0, 0.35)}, False),
        ({"early": np.full(1, -0.02)}, False),
        ({"alike": [(0, 0)]}, False),
        ({"recurring": np.full(1, 1.0)}, False),
        ({"several": True}, False),
        ({"lagged": np.ones(1, dtype=bool)}, False),
        ({"accurate": False}, False),
        ({"closed": 0.98}, False),
        ({"validation": Validation({"model": 1.0, "static": 0.5}, "static")}, False),
        ({"interval": (0.9, HIGH)}, False),  # perhaps longer
        ({"as_good": True}, False),
        ({"still": np.ones(1, dtype=bool)}, False),
        ({"assumed": {"a": -3.9}}, True),
        ({"assumed": {"a": -4.1}}, False),
    ],
)
def test_a_delay_is_known_where_nothing_else_explains_the_log(changes, known):
    findings = said(**changes)
    assert findings.identifiable.tolist() == [known]
    assert ("U arrives 0.3 s late" in findings.sentences[0]) is known
    assert any(word in findings.sentences[0] for word in ("not identifiable", "no answer")) is not known


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"interval": (0.0, 0.04)}, "The log fits without a delay of U, too."),
        ({"interval": (0.0, 0.35)}, "any delay of 0 s to 0.35 s fits."),
        ({"early": np.full(1, -0.02)}, "0.02 s before its command. Either it is logged late, or"),
        ({"recurring": np.full(1, 1.0)}, "U repeats itself after 1 s"),
        ({"several": True}, "several delays of 0.25 s to 0.35 s fit about equally well"),
        ({"accurate": False}, "There is no answer: the model is too fast for the samples"),
        (
            {"validation": Validation({"model": 1.0, "static": 0.5}, "static")},
            "The error of predictions is 0.5 by constant gains alone, and 1 by the model.",
        ),
        (
            {"combination": Combination(["k", "c"], [1.0, -2.0], 3.0, 0.01)},
            "Of k and c only a combination is known, near these values: k - 2 c = 3 ± 0.02.",
        ),
        (
            {"behind": (0.12, 0.2)},
            "A delay of 0.12 s with a first-order lag of 0.2 s behind it fits clearly better: if there is such a lag",
        ),
        ({"closed": 0.98}, "the log is of a closed loop without a test signal. Add one."),
        ({"inflation": 2.1}, "Errors keep their sign for 2.1 samples"),
        ({"assumed": {"a": 2.1}}, "another value of a: its error is 2.1 times `model_error`."),
        (
            {"parameters": {"a": Parameter(1.0, 0.9, 1.1, -0.96)}},
            "hardly tells a from the delay: their errors correlate with -0.96",
        ),
        ({"parameters": {"a": Parameter(1.0, -5.0, 5.1, 0.0)}}, "a is not identifiable"),
    ],
)
def test_what_is_odd_is_said_and_only_then(changes, words):
    assert words in "\n".join(said(**changes).sentences) and words not in "\n".join(said().sentences)
