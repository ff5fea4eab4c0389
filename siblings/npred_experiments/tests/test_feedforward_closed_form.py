"""The plant with a closed form: an independent loop meets it to rounding, npred's at first order in dt."""

import numpy as np
import pytest

from npred_experiments import feedforward_closed_form as experiment


def test_the_delayed_loop_meets_the_closed_form():
    t, Z = experiment.delayed_loop()
    assert np.abs(Z - experiment.closed_form(t)).max() < 1e-11


def test_the_printed_command_is_that_of_a_delay_earlier():
    """Along the closed form Z2' is U(t - D): the command as printed, read at t, is Z2' of the same t."""
    t, step = np.linspace(1.5, 7.5, 61), 1e-5
    slope = (experiment.closed_form(t + step)[:, 1] - experiment.closed_form(t - step)[:, 1]) / (2 * step)
    assert slope == pytest.approx(experiment.command(t, experiment.D), abs=1e-9)
    assert np.abs(slope - experiment.command(t)).max() > 0.1


def test_npred_is_of_first_order_in_the_step_of_its_hold():
    errors = [experiment.meant(dt) for dt in (0.01, 0.005, 0.0025)]
    assert np.diff(np.log2(errors)) == pytest.approx([-1.0, -1.0], abs=0.03)


def test_the_repositorys_own_loop():
    assert experiment.euler_loop() == pytest.approx(0.735694, abs=5e-7)
