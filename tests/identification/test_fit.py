"""Which of two fits the data prefer."""

import numpy as np
import pytest

from npred.identification.fit import Prior, SegmentFit, better

SEGMENTS = 30


def fit(costs) -> SegmentFit:
    """A fit with these costs of its segments, without parameters."""
    nothing = Prior(np.zeros(0), np.zeros(0), np.zeros((2, 0)))
    e, shape = np.array(costs, dtype=float), (len(costs), 0)
    return SegmentFit(np.zeros(1), np.zeros((len(e), 1)), np.zeros(0), e, np.zeros(shape), np.zeros((*shape, 0)),
                      nothing, np.zeros((len(e), 9, 1)))  # fmt: skip


def gains(*values: float, others: float = 0.0) -> np.ndarray:
    """Costs of 9 a segment, and so much more in the first ones and in the others."""
    return 9.0 + np.append(values, np.full(SEGMENTS - len(values), others))


def test_what_each_segment_says_decides():
    even = gains(others=0.5)  # 15 in all
    assert better(fit(gains()), fit(even), 1.0) and not better(fit(even), fit(gains()), 1.0)


@pytest.mark.parametrize("strange", [(20.0,), (1e6,), (np.inf,), (25.0, -9.0)])
def test_one_strange_segment_alone_decides_nothing(strange):
    """Whatever it says, while the others hardly say the reverse: a pump that was off makes no lag of a delay."""
    assert not better(fit(gains()), fit(gains(*strange, others=-0.05)), 1.0)
