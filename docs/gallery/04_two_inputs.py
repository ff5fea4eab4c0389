"""
Two inputs, two delays
======================

A robot steers late and drives later: the turning rate acts after 0.2 s, the
speed after 0.6 s. Each input has a delay in the plant's declaration.
"""

import numpy as np

import npred


class Robot:
    """A unicycle that is held on a line: offset, heading and speed."""

    states, inputs = ("offset", "heading", "speed"), ("turn", "push")
    units = {"offset": "m", "heading": "rad", "speed": "m/s"}
    box = {"offset": (-0.5, 0.5), "heading": (-0.4, 0.4), "speed": (0.5, 1.5)}
    guess = (0.0, 0.0, 1.0)
    delays = (0.2, 0.6)

    @staticmethod
    def f(x, u, t, p, M):
        return [x.speed * M.sin(x.heading), u.turn, u.push]

    @staticmethod
    def kappa(x, t, p, M):
        return [-2.0 * x.offset - 3.0 * x.heading, -3.0 * (x.speed - 1.0)]


robot = npred.plant(Robot)
rk4 = npred.predictor(robot, "rk4")
starts = [[0.5, 0.3, 0.6], [-0.4, 0.2, 1.4], [0.2, -0.4, 1.0]]
loops = npred.simulate(
    robot, rk4, D=0.6, D_hat=0.6, X0=starts, t_end=6.0, dt=0.01
)
axes = loops.plot()
print("furthest from the line at the end:", np.abs(loops.X[:, -1, 0]).max())
assert np.abs(loops.X[:, -1] - [0, 0, 1]).max() < 0.01
