"""Parts in Python that a loop in C calls."""

import numpy as np
import pytest

from npred.kernels.kernel import Failure, Shape, address, callback


def called(function):
    """What it leaves in U (m, lanes) for X (n, lanes) = 1000, and its failure."""
    X, U, work, failure = np.full((2, 3), 1000.0), np.zeros((1, 3)), np.zeros(1), Failure()
    run = callback(function, "X, &U", {}, failure)
    run(Shape(nx=2, lanes=3, rows=0, n=2, m=1), address(X), address(U), address(work))
    return U, failure


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_what_leaves_the_floats_is_no_cause_for_a_warning():
    def explode(X, U):
        U[0] = np.exp(X[0]) - np.exp(X[1])

    U, failure = called(explode)
    assert np.isnan(U).all() and U.shape == (1, 3)
    failure.raised()  # nothing


def test_what_it_raises_waits_for_the_loop():
    def fail(X, U):
        raise KeyError("a sensor")

    _, failure = called(fail)
    assert failure.flag.value == 1
    with pytest.raises(KeyError, match="a sensor"):
        failure.raised()
    failure.raised()  # once
