"""What is said of a log, by what was found."""

import numpy as np
import pytest
from test_identify import decay

from npred.identification.alternatives import Alternative
from npred.identification.estimate import Parameter
from npred.identification.identified import Findings

HIGH = 1.5


def said(interval=(0.25, 0.35), as_good=False, behind=None, **changes) -> Findings:
    """Findings of a delay of 0.3 s, of which delays up to 1.5 s were tried."""
    found = {
        "plant": decay(), "D": np.array([0.3]), "interval": np.array([interval]),
        "high": np.full(1, HIGH), "period": 0.05, "alternatives": [Alternative(0.2, as_good, behind)],
        "still": np.zeros(1, dtype=bool), "parameters": {}, "assumed": {}, "inflation": 1.0, "closed": 0.0,
        "held_back": {},
    }  # fmt: skip
    return Findings(**found | changes)


@pytest.mark.parametrize(
    ("changes", "known"),
    [
        ({}, True),
        ({"interval": (0.0, 0.49 * HIGH)}, True),
        ({"interval": (0.0, 0.51 * HIGH)}, False),  # half of what was tried
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
    assert ("The delay of U is not identifiable" in findings.sentences[0]) is not known


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"interval": (0.0, 0.35)}, "No delay of U at all fits the log as well."),
        ({"behind": (0.12, 0.2)}, "A delay of 0.12 s with a first-order lag of 0.2 s behind it fits clearly better."),
        ({"as_good": True, "closed": 0.96}, "the log is of a closed loop without a test signal. Add one."),
        ({"inflation": 2.1}, "Errors stay on one side for 2.1 samples"),
        ({"assumed": {"a": 2.1}}, "The log asks for another value of a, 2.1 times as far as was allowed."),
        (
            {"parameters": {"a": Parameter(1.0, 0.9, 1.1, -0.96)}},
            "hardly tells a from the delay: their errors correlate by -0.96",
        ),
        ({"parameters": {"a": Parameter(1.0, -5.0, 5.1, 0.0)}}, "a is not identifiable"),
    ],
)
def test_what_is_odd_is_said_and_only_then(changes, words):
    assert words in "\n".join(said(**changes).sentences) and words not in "\n".join(said().sentences)
    if "closed" in changes:  # a log that tells the delay needs no test signal
        assert words not in "\n".join(said(closed=0.96).sentences)
