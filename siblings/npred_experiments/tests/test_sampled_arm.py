"""The sampled arm: when it samples, and the numbers of the figures, as they were logged and of one time."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from npred_experiments import sampled_arm as experiment


@pytest.fixture(scope="module")
def signals():
    return experiment.loop()


def test_it_samples_when_the_source_does(signals):
    assert np.diff(signals.sampled)[:5].tolist() == [51, 89, 85, 88, 70] and len(signals.sampled) == 336
    assert experiment.tracking(signals.X[..., 0])[0] == pytest.approx(0.4006, abs=5e-5)


def test_the_logged_numbers_are_those_of_the_figures(signals, monkeypatch):
    monkeypatch.setattr(experiment, "loop", lambda: signals)
    rows = experiment.measure()
    logged = [rows[name].as_published for name in experiment.ROWS]
    assert logged == pytest.approx([0.8337, 0.16859, 0.03926, 0.01501], abs=1e-5 + 5e-5)
    assert [round(logged[0], 4), round(logged[2], 5), round(logged[3], 5)] == [0.8337, 0.03926, 0.01501]
    assert abs(rows["tracking, highest"].as_meant - logged[0]) > 1e-4


def test_a_sample_without_noise_would_be_predicted_exactly(signals):
    """The torques under way, given to the plant by SciPy: half a second of the loop's own states."""
    arm, plant = experiment.kernels(), experiment.npred.plant("xarm6")
    torques = [arm.law(Z, k * experiment.DT + experiment.D)[:, 0] for k, Z in enumerate(signals.Z[:500])]
    k = 700  # of the state, with the torques of steps 500 … 699 behind it
    x = signals.X[500, :, 0]
    for torque in torques[300:350]:
        solved = solve_ivp(lambda t, X, u=torque: plant.f(X, u), (0, experiment.DT), x, rtol=1e-10, atol=1e-12)
        x = solved.y[:, -1]
    np.testing.assert_allclose(x, signals.X[k - 150, :, 0], atol=1e-9)


def test_mean_torques_of_20_ms_are_enough_for_a_network():
    """The prediction with them is nearer to the exact one than the noise of a sample moves it."""
    logged = experiment.loop(1500)
    X = logged.X[[300, 600, 900, 1200], :, 0]
    u = np.stack([np.stack(logged.torques[k : k + 201])[..., 0] for k in (300, 600, 900, 1200)])
    D = np.full(4, experiment.D)
    exact, means = experiment.held()(X, u, D, 0.0), experiment.of_means(experiment.held(experiment.CELL))(X, u, D, 0.0)
    assert means.shape == (4, 11, 12) and exact.shape == (4, 201, 12)
    assert 0 < np.abs(means[:, -1, :6] - exact[:, -1, :6]).max() < experiment.NOISE / 5


def test_runs_to_learn_from_are_side_by_side(monkeypatch):
    monkeypatch.setattr(experiment, "OTHERS", 3)
    runs = experiment.others(np.random.default_rng(0))
    logged = experiment.loop(300, runs=runs)
    assert logged.X.shape == (301, 12, 3)
    alone = runs._replace(X0=runs.X0[:, 1:2], noise=lambda: np.zeros((12, 1)), gap=lambda: 400)
    beside = runs._replace(noise=lambda: np.zeros((12, 3)), gap=lambda: 400)
    np.testing.assert_allclose(
        experiment.loop(300, runs=beside).X[..., 1:2], experiment.loop(300, runs=alone).X, atol=1e-12
    )
