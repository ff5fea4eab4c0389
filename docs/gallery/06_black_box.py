"""
A plant that is a black box
===========================

Sometimes ``f`` is a simulator that cannot be traced. With ``traced = False``
npred calls the functions of the plant's file with arrays of states, (B, n).
"""

import tempfile
from pathlib import Path

import numpy as np

import npred

folder = Path(tempfile.mkdtemp())
(folder / "simulator.py").write_text(
    '''
import numpy as np


class Pendulum:
    """Imagine a library for robots behind these lines."""

    traced = False
    states, inputs = ("theta", "omega"), ("torque",)
    box = {"theta": (-0.5, 0.5), "omega": (-0.5, 0.5)}
    guess = (0.0, 0.0)

    @staticmethod
    def f(X, u, t, p):  # X (B, n), u (B, m) -> (B, n)
        fall = 10.0 * np.sin(X[:, 0])
        return np.stack([X[:, 1], fall + u[:, 0]], axis=1)

    @staticmethod
    def kappa(X, t, p):  # -> (B, m)
        return (-10.0 * np.sin(X[:, 0]) - 4.0 * X.sum(axis=1))[:, None]
'''
)

plant = npred.plant(f"{folder}/simulator.py:Pendulum")
rk4 = npred.predictor(plant, "rk4", nx=21)
loop = npred.simulate(
    plant, rk4, D=0.3, D_hat=0.3, X0=[0.3, 0.0], t_end=4.0, dt=0.01
)
axes = loop.plot(D=0.3)
print(loop)
assert np.abs(loop.X[-1]).max() < 0.01
