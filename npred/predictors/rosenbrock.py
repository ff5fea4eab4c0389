"""A linearly implicit method, for stiff plants of any kind."""

import math

import numpy as np

from npred.predictors.base import OneStep
from npred.symbolic import Array, Value
from npred.symbolic.called_functions import whole
from npred.symbolic.implicit import linearised, solver
from npred.symbolic.trace import Trace

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)


class Rosenbrock(OneStep):
    """ROS2 with gamma = 1 - 1/sqrt(2): order 2, L-stable, two linear systems with one matrix per step.

    With W = I - gamma h f_X and d = f_t h + f_U (u1 - u0):
        W k1 = f(x, u0, t) + gamma d,   W k2 = f(x + h k1, u1, t + h) - 2 k1 - gamma d,
        x(t + h) = x + h (3 k1 + k2) / 2.
    The term d keeps the order where a stiff plant follows its inputs; f_X, f_t and f_U come from the traced f.
    Verwer, Spee, Blom, Hundsdorfer, SIAM J. Sci. Comput. 20 (1999) 1456. Raises ConfigError for a plant that is not
    traced.
    """

    name, order = "rosenbrock", 2

    @staticmethod
    @whole
    def step(f: Trace, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
        velocity, jacobian, d = linearised(f, x, u0, t, None if u0 is u1 else u1 - u0, h)
        solve = solver((np.eye(len(x)) - GAMMA * h * jacobian).tolist())
        k1 = np.array(solve([*(velocity + GAMMA * d)]), dtype=object)
        k2 = np.array(solve([*(f(x + h * k1, u1, t + h) - 2.0 * k1 - GAMMA * d)]), dtype=object)
        return x + h * (1.5 * k1 + 0.5 * k2)
