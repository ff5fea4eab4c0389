"""Both published loops of the wheeled robot with one delay, and what is wrong in them."""

import numpy as np
import pytest

from npred_experiments import pomet, unicycle_constant, unicycle_time_varying


def test_the_constant_delay_gives_the_printed_digits():
    X, P = unicycle_constant.published_loop()
    assert f"{unicycle_constant.shifted_error(X, P):.6f}" == "0.028543"
    X0, D = unicycle_constant.draws()
    assert X0[:, 0] == pytest.approx([0.9834044, 1.0440649, 0.90002287], abs=5e-9)
    assert D[0] == pytest.approx(1.0302332573, abs=5e-11)


def test_most_of_the_printed_error_is_the_metrics_shift():
    """Each run shifted by the samples that fit it best, the error is a fifth of the printed one."""
    X, P = unicycle_constant.published_loop()
    shifts = range(97, 107)
    errors = [np.linalg.norm(P[: 1000 - shift] - X[shift:], axis=1).mean(axis=0) for shift in shifts]
    assert np.min(errors, axis=0).mean() == pytest.approx(0.005563, abs=1e-5)


def test_the_right_law_in_the_published_loop():
    assert unicycle_constant.shifted_error(*unicycle_constant.published_loop(pomet.right_law)) == pytest.approx(
        0.020326959, abs=5e-9
    )


@pytest.mark.parametrize(("law", "largest"), [(pomet.published_law, 0.3458), (pomet.right_law, 0.0535)])
def test_without_delay_the_published_law_stays_away_from_the_origin(law: pomet.Law, largest: float):
    step, X, late = 0.005, np.ones(3), []

    def rate(t: float, X: np.ndarray) -> np.ndarray:
        return np.array(pomet.f(tuple(X), law(tuple(X), t)))

    for k in range(12000):
        t = k * step
        a = rate(t, X)
        b = rate(t + step / 2, X + step / 2 * a)
        c = rate(t + step / 2, X + step / 2 * b)
        X = X + step / 6 * (a + 2 * b + 2 * c + rate(t + step, X + step * c))
        late += [np.linalg.norm(X)] if t >= 55 else []
    assert max(late) == pytest.approx(largest, abs=2e-3)


def test_the_time_varying_delay_gives_the_printed_digits_with_either_law():
    published, right = (
        np.linalg.norm(unicycle_time_varying.published_loop(law), axis=1).mean()
        for law in (pomet.published_law, pomet.right_law)
    )
    assert published == pytest.approx(0.612849878, abs=5e-10)
    assert right == pytest.approx(0.562503557, abs=5e-10)


def test_the_inverse_of_the_delay_and_its_rate():
    b, t = np.array([2.0, 2.1, 4.0]), 1.7
    sigma = unicycle_time_varying.arrival(t, b)
    assert sigma - (1 + sigma) / (1 + b * sigma) == pytest.approx([t, t, t], abs=1e-14)
    step = 1e-5
    slope = (unicycle_time_varying.arrival(t + step, b) - unicycle_time_varying.arrival(t - step, b)) / (2 * step)
    assert unicycle_time_varying.arrival_rate(t, b) == pytest.approx(slope, rel=1e-9)


def test_the_published_line_is_late_and_the_right_speed_is_not():
    """A signal of t = 4 arrives at σ(4) at the right speed of the line, 0.4 s after that at the published one."""
    b, entry, x = np.array(2.0), 4.0, 1.0
    sigma = unicycle_time_varying.arrival(entry, b)
    arrivals = []
    for right in (True, False):
        t, x, step = entry, 1.0, 1e-4
        while x > 0:
            horizon = unicycle_time_varying.arrival(t, b) - t
            bend = x * (unicycle_time_varying.arrival_rate(t, b) - 1)
            x -= step * ((1 + bend) / horizon if right else 1 + bend / horizon)
            t += step
        arrivals.append(t)
    assert arrivals[0] == pytest.approx(sigma, abs=1e-3)
    assert arrivals[1] - sigma > 0.4


def test_as_meant_the_prediction_error_is_that_of_the_grid():
    assert unicycle_constant.meant() < 1e-3
    assert unicycle_time_varying.meant() == pytest.approx(0.475, abs=5e-4)
