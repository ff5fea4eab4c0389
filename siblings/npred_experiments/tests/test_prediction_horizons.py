"""The drawn delays, and the inverse of t - D(t) by three methods."""

import numpy as np
import pytest

from npred_experiments import prediction_horizons as experiment


def test_the_delays_are_those_that_the_article_prints():
    for delay, digits in zip(experiment.draws(), experiment.DIGITS, strict=True):
        assert delay == pytest.approx([float(text) for text in digits], abs=0.01)
    assert experiment.draws()[0] == pytest.approx(
        (0.4014052435, 0.3152573253, -0.1021609701, 4.9538436451, 0.9525146483), abs=5e-11
    )


def test_the_first_draw_is_refused_because_its_commands_overtake_each_other():
    generator = np.random.default_rng(1)
    ranges = ((0.1, 0.5), (0.1, 0.5), (-0.3, 0.3), (0.0, 2 * np.pi), (0.0, np.pi))
    first = tuple(float(generator.uniform(*ends)) for ends in ranges)
    assert experiment.rate(first, np.linspace(0, 12, 4001)).min() == pytest.approx(-0.27, abs=0.005)


def test_newtons_method_is_exact_and_the_integrated_inverse_is_not():
    delay = experiment.draws()[0]
    assert experiment.residual(delay) < 1e-14
    assert experiment.residual(delay, experiment.euler) == pytest.approx(3.084e-4, rel=1e-3)
    assert experiment.residual(delay, experiment.rk4) == pytest.approx(1.77e-11, rel=0.02)
