"""The wheeled robot with two delays: the published norm, and the steering that its predictor forgets."""

import numpy as np
import pytest

from npred_experiments import unicycle_two_inputs as experiment


def test_from_ones_the_published_loop_gives_its_norm_in_the_published_unit():
    X, _ = experiment.published_loop(np.ones((3, 1)))
    assert experiment.norm(X, experiment.DX)[0] == pytest.approx(5.0910, abs=5e-5)
    assert experiment.norm(X, experiment.DT)[0] == pytest.approx(5.0910 / 10**0.5, abs=5e-5)


def test_without_the_steering_the_prediction_is_not_the_state_that_comes():
    """|P2(t) - X(t + 0.6)| over the first second: 0.3 rad of the angle, 0.03 with the steering that will be sent."""
    later, errors = round(experiment.D2 / experiment.DT), []
    for steers in (False, True):
        X, P2 = experiment.published_loop(np.ones((3, 1)), steers, steps=1200)
        errors.append(np.abs(P2[400:-later] - X[400 + later :]).max())
    assert errors[0] > 5 * errors[1]


def test_the_first_commands_of_the_example_with_unit_gains():
    assert experiment.first_commands() == pytest.approx((-0.664906519, -0.645494470), abs=5e-10)
    assert experiment.first_commands_meant() == pytest.approx((-0.664906519, -0.645494470), abs=1e-8)
