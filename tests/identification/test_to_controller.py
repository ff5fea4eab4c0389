"""From a recording to a controller of that plant, and what is said of a log."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded import looped, steps
from test_identify import decay

import npred
from npred.identification.alternatives import Alternative, Lines, Validation
from npred.identification.estimate import Combination, Parameter
from npred.identification.identified import Findings
from npred.identification.objections import settled
from npred.identification.windows import Windows

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


def windows(*D: float, half: float = 0.05) -> Windows:
    """Windows with these delays of one input, each known up to `half`."""
    middle = np.array(D)[:, None]
    return Windows(
        np.arange(len(D)) + 0.5, middle, middle[..., None] + half * np.array([-1.0, 1.0]), 0.05, np.full(1, HIGH)
    )


def said(interval=(0.25, 0.35), as_good=False, behind=None, **changes) -> Findings:
    """Findings of a delay of 0.3 s, of which delays up to 1.5 s were tried."""
    found = {
        "plant": decay(), "D": np.array([0.3]), "early": np.zeros(1), "interval": np.array([interval]),
        "high": np.full(1, HIGH), "period": 0.05,
        "alternatives": [Alternative(0.2, as_good, False, 0.0, behind, None)], "lines": None, "late": np.zeros(1),
        "windows": windows(0.3, 0.3), "scatter": np.zeros(1), "varies": np.zeros(1, dtype=bool),
        "share": 0.0, "following": 0.0,
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
        ({"scatter": np.full(1, 0.1)}, False),
        ({"lagged": np.ones(1, dtype=bool)}, False),
        ({"accurate": False}, False),
        ({"closed": 0.98}, False),
        ({"validation": Validation({"model": 1.0, "static": 0.5}, "static")}, False),
        ({"interval": (0.9, HIGH)}, False),  # perhaps longer
        ({"as_good": True}, False),
        ({"still": np.ones(1, dtype=bool)}, False),
        ({"varies": np.ones(1, dtype=bool)}, False),
        ({"inflation": 2.1, "following": 0.29}, True),
        ({"inflation": 2.1, "following": 0.31}, False),
        ({"inflation": 2.1, "following": 0.16, "share": 0.03}, False),
        ({"inflation": 5.1, "share": 0.29}, True),
        ({"inflation": 5.1, "share": 0.31}, False),
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
        ({"varies": np.ones(1, dtype=bool)}, "windows of the log have different ones, in their order 0.3 s, 0.3 s."),
        ({"inflation": 2.1, "following": 0.6}, "60% of them follow the commands. Add the states or the mode"),
        (
            {"inflation": 5.1, "share": 0.5},
            "the model is poor: its errors keep their sign for 5.1 samples, and are 50%",
        ),
        ({"lagged": np.ones(1, dtype=bool), "behind": (0.1, 0.2)}, "Add a state for the lag to the plant."),
        ({"late": np.full(1, 0.1)}, "a command may be older than its row, in the mean by up to 0.1 s."),
        (
            {"lines": Lines(np.full(1, 0.33), np.array([[0.3, 0.36]]), True, False)},
            "Commands in straight lines fit as well, with a delay of 0.33 s",
        ),
        ({"accurate": False}, "There is no answer: the model is too fast for the samples"),
        (
            {"validation": Validation({"model": 1.0, "static": 0.5}, "static")},
            "The error of predictions (unit of X) is 0.5 by constant gains alone, and 1 by the model.",
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
        (
            {"parameters": {"a": Parameter(1.0, -5.0, 5.1, 0.0)}},
            "a is not identifiable: the log fits any value from -5",
        ),
        ({"parameters": {"a": Parameter(1e-9, 1e-9, 5.1, 0.0)}}, "the log fits any value below 5.1"),
        ({"parameters": {"a": Parameter(3.0, 0.7, 1e9, 0.0)}}, "the log fits any value above 0.7"),
        ({"parameters": {"a": Parameter(3.0, 1e-9, np.inf, 0.0)}}, "the log fits almost any value of it"),
        (
            {"validation": Validation({"model": 1.0}, None, 75, 0, {"model": np.array([0.3])}, {})},
            "quarter of the log, 75 samples, which was held back:\n"
            "  model      delay  error (unit of X)\n  the model  0.3 s  1",
        ),
        (
            {
                "validation": Validation(
                    {"lag_and_delay": 1.0}, None, 75, None, {"lag_and_delay": [0.3]}, {"lag_and_delay": [0.1]}
                )
            },
            "  model                              delay             error (standard deviations of the outputs)\n"
            "  with a lag behind a shorter delay  0.3 s, lag 0.1 s  1",
        ),
    ],
)
def test_what_is_odd_is_said_and_only_then(changes, words):
    assert words in "\n".join(said(**changes).sentences) and words not in "\n".join(said().sentences)


@given(
    low=st.floats(0.1, 0.6), rival=st.floats(0.1, 0.6), line=st.floats(0.1, 0.6), late=st.floats(0.0, 0.2),
    scatter=st.floats(0.0, 0.1), D=st.lists(st.floats(0.1, 0.6), min_size=2, max_size=6),
)  # fmt: skip
def test_an_interval_holds_all_that_was_seen_and_an_answer_that_is_contradicted_is_not_certain(
    low, rival, line, late, scatter, D
):
    ends = lambda value: (value, value + 0.05)
    over_time = windows(*D, half=0.01)
    findings = settled(
        said(
            ends(low), windows=over_time, late=np.full(1, late), scatter=np.full(1, scatter),
            alternatives=[Alternative(0.2, False, False, 1.0, (rival, 0.1), ends(rival))],
            lines=Lines(np.array([line]), np.array([ends(line)]), True, False),
        )
    )  # fmt: skip
    begin, end = findings.interval[0]
    assert begin <= min(low, rival, line) and end >= max(low, rival, line) + 0.05 + late - 1e-12
    assert begin <= 0.3 - 2 * scatter + 1e-12 and end >= 0.3 + 2 * scatter + late - 1e-12
    if rival + 0.05 + late < low - 1e-12 or scatter:
        assert not findings.identifiable[0]
    if findings.varies[0]:
        assert begin <= min(D) - 0.01 + 1e-12 and max(D) + 0.01 - 1e-12 <= end and findings.D[0] >= D[-1]
        assert not findings.identifiable[0]
    if not late:
        assert findings.varies[0] == over_time.vary(0, np.array(ends(low)))


@pytest.mark.parametrize(
    ("D", "varies"),
    [
        ((0.30, 0.31, 0.29, 0.30), False),
        ((0.20, 0.20, 0.40, 0.40), True),  # a change
        ((0.24, 0.28, 0.32, 0.36), True),  # a clock that drifts
    ],
)
def test_windows_differ_if_they_scatter_more_than_their_intervals_say(D, varies):
    found = windows(*D, half=0.02)
    assert found.vary(0, np.array([0.25, 0.35])) is varies
    (low, high), last = found.seen(0)
    assert last == D[-1] and low <= min(D) - 0.02 and high >= max(max(D) + 0.02, 2 * D[-1] - D[-2])
