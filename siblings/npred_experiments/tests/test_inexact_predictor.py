"""Two delays predicted as one: the printed digits, the first prediction by SciPy, and the root's mode."""

import math

import numpy as np
import pytest
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm, null_space

from npred_experiments import inexact_predictor as two
from npred_experiments.inexact_predictor import D0, D1, D2

A = np.array([[0.0, 1.0], [0.0, 1.0]])
C1, C2 = np.array([[0.0, 0.0], [-6.0, -10.0]]), np.array([[0.0, 0.0], [-10.0, -10.0]])


@pytest.mark.parametrize(("dt", "printed"), [(0.005, 0.0143775275), (0.002, 0.0146192334)])
def test_the_printed_distances_of_coarser_steps(dt: float, printed: float):
    assert math.hypot(*two.audited(dt)[2]) == pytest.approx(printed, abs=6e-11)


def test_the_first_prediction_is_that_of_scipy():
    rate = lambda t, x: [x[1], -x[0] + math.sin(x[0]) + x[1]]
    P = solve_ivp(rate, (0, D0), two.START, rtol=1e-13, atol=1e-13).y[:, -1]
    first, u, _ = two.audited(t_end=0.0)
    assert first == pytest.approx(P, abs=1e-11)
    assert u == pytest.approx((-11.6010660825110, -29.3576817206423), abs=1e-11)


def test_the_root_is_a_mode_of_plant_and_predictor():
    """With p e^(st) for P, x = exp(-A D0) (1 - Q) p, Q = ∫ exp((A - s) r) (C1 + C2) dr over D0, obeys the plant."""
    s, eye = two.root(), np.eye(2)
    assert (s.real, s.imag) == pytest.approx((0.682101813345006, 53.148865919078973), abs=1e-13)
    lag1, lag2, lag0 = (np.exp(-s * D) for D in (D1, D2, D0))
    M = s * eye - A - C1 - C2 - expm(A * D0) @ (C1 * (lag1 - lag0) + C2 * (lag2 - lag0))
    p = null_space(M, rcond=1e-10)[:, 0]
    Q = quad_vec(lambda r: expm((A - s * eye) * r) @ (C1 + C2), 0, D0, epsabs=1e-12)[0]
    x = expm(-A * D0) @ (eye - Q) @ p
    assert (s * eye - A) @ x == pytest.approx((C1 * lag1 + C2 * lag2) @ p, abs=1e-9)


def test_both_loops_come_to_one_at_their_orders():
    """After 0.7 s; later the mode that grows makes a small difference large."""
    ends = [np.array(two.audited(dt, 0.7)[2]) for dt in (0.01, 0.005, 0.0025)]
    changes = [np.abs(a - b).max() for a, b in zip(ends, ends[1:], strict=False)]
    assert np.log2(changes[0] / changes[1]) == pytest.approx(2.0, abs=0.1)
    limit = math.hypot(*ends[-1])
    errors = [abs(two.held(dt, 0.7)[4] - limit) for dt in (0.0025, 0.00125)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.3)
