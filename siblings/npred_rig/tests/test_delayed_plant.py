"""The truth of a rig against the closed form of a linear plant, and what it says of its commands."""

import numpy as np
import pytest

import npred
from npred.lab.config import Evaluate
from npred.loop.measurement import Sensors
from npred_rig.network import Packet
from npred_rig.sides import DelayedPlant


def scalar(D: float) -> DelayedPlant:
    plant = npred.plant("scalar")  # X' = X/2 + U
    return DelayedPlant(plant, Evaluate(X0=[1.0], D=D, D_hat=D, dt=0.02), np.zeros(1))


def exact(X: float, U: float, span: float) -> float:
    return (X + 2 * U) * np.exp(span / 2) - 2 * U


def test_commands_act_a_delay_after_they_arrive_and_old_ones_never():
    plant = scalar(0.3)
    for arrival, number, sent_at, U in ((0.1, 0, 0.0, -1.0), (0.25, 2, 0.05, 3.0), (0.26, 1, 0.02, 9.0)):
        plant.command(Packet(arrival, number, sent_at, np.array([U])))
    X = exact(exact(exact(1.0, 0.0, 0.4), -1.0, 0.15), 3.0, 0.45)
    assert plant.to(1.0)[0] == pytest.approx(X, rel=1e-10)
    ages = 0.15 * (0.4 + 0.55) / 2 + 0.45 * (0.5 + 0.95) / 2  # the acting one's, linear between changes
    assert plant.age == pytest.approx(ages / 0.6)


def test_regular_commands_have_the_age_of_their_delay_and_half_a_step():
    plant, dt = scalar(0.2), 0.01
    for k in range(200):
        plant.command(Packet(k * dt + 0.1, k, k * dt, np.array([-0.5])))
    plant.to(0.3 + 199 * dt + dt)
    assert plant.age - dt / 2 == pytest.approx(0.3, rel=1e-6)


def test_sensors_have_their_errors():
    X, rng = np.full((20000, 2), 2.0), np.random.default_rng(0)
    Y = Sensors(relative_noise=0.1, noise=[0.0, 0.3], bias=[0.0, 1.0], resolution=[0.0, 0.5]).sampled(X, rng)
    assert Y[:, 0].std() == pytest.approx(0.2, rel=0.05)
    assert Y[:, 1].mean() == pytest.approx(3.0, rel=0.01)
    assert Y[:, 1].std() == pytest.approx(np.sqrt(0.2**2 + 0.3**2 + 0.5**2 / 12), rel=0.05)
    assert np.array_equal(Y[:, 1] * 2, np.round(Y[:, 1] * 2))
