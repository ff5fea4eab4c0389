"""The pendulum whose command acts twice: the printed digits, and its law by SciPy."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from npred_experiments import distributed_delay as pendulum


@pytest.mark.parametrize(
    ("dt", "start", "printed"),
    [
        (0.01, math.pi / 2, (0.0236523098, -0.0127597473, -7.467661123)),
        (0.01, math.pi, (0.0392582942, -0.0211772422, -6.811116128)),
        (0.01, 3 * math.pi / 2, (0.0571139653, -0.0308053963, -8.860879088)),
        (0.02, math.pi, (0.0391261633, -0.0210209478, -6.829414298)),
        (0.005, math.pi, (0.0393781337, -0.0212642890, -6.802301875)),
    ],
)
def test_every_printed_run_to_its_digits(dt: float, start: float, printed: tuple[float, ...]):
    assert pendulum.published(dt, (start, math.pi / 2)) == pytest.approx(printed, abs=6e-10)


def test_the_first_command_is_that_of_scipy():
    """ξ by solve_ivp; β(h) is the derivative of ξ(h) by x2, by central differences."""

    def coasted(x2: float) -> np.ndarray:
        rate = lambda s, x: [x[1], math.sin(x[0]) + 1.0]
        return solve_ivp(rate, (0, pendulum.H), [math.pi, x2], rtol=1e-12, atol=1e-12).y[:, -1]

    y, step = coasted(math.pi / 2), 1e-4
    beta = (coasted(math.pi / 2 + step) - coasted(math.pi / 2 - step)) / (2 * step)
    assert pendulum.held(40)[2] == pytest.approx(-np.dot(beta + np.array([0.0, 1.0]), y), abs=1e-6)


def test_both_schemes_have_one_limit():
    limit = pendulum.meant()
    errors = [np.abs(pendulum.held(cells) - limit)[:2].max() for cells in (40, 80)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.2)
    fine = 2 * pendulum.published(pendulum.H / 314)[:2] - pendulum.published(pendulum.H / 157)[:2]
    assert fine == pytest.approx(limit[:2], abs=5e-5)  # these end up to dt / 2 beside t = 10 s
