"""
A plant that is a black box
===========================

Sometimes ``f`` is a simulator, and nobody can trace it. ``traced = False`` takes
the functions as they are: they are called with arrays (batch, n).
"""

import numpy as np

import npred


class Simulator:
    """A pendulum; imagine a library of robots behind these lines."""

    states, inputs = ("theta", "omega"), ("torque",)
    box = {"theta": (-0.5, 0.5), "omega": (-0.5, 0.5)}
    guess = (0.0, 0.0)
    traced = False

    def f(X, u, t, p):
        theta, omega = X[:, 0], X[:, 1]
        return np.stack([omega, 10.0 * np.sin(theta) + u[:, 0]], axis=1)

    def kappa(X, t, p):
        theta, omega = X[:, 0], X[:, 1]
        return (-10.0 * np.sin(theta) - 4.0 * theta - 4.0 * omega)[:, None]


box = npred.plant(Simulator)
rk4 = npred.predictor("rk4", box, nx=21)
loop = npred.simulate(
    box, rk4, D=0.3, D_hat=0.3, X0=[0.3, 0.0], t_end=4.0, dt=0.01
)
axes = loop.plot(D=0.3)
print(loop)
assert np.abs(loop.X[-1]).max() < 0.01
