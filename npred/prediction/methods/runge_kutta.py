"""Explicit Runge-Kutta methods."""

from npred.formulas import Array, Value
from npred.prediction.methods.base import Flow, OneStep


class Euler(OneStep):
    """x + h f(x, u): order 1, the paper's scheme, which takes u at the begin of a step."""

    name, order = "euler", 1

    @staticmethod
    def step(f: Flow, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
        return x + h * f(x, u0, t)


class Heun(OneStep):
    """The trapezoidal rule with Euler's step as its end point: order 2. Hairer, Nørsett, Wanner, Table II.1.1."""

    name, order = "heun", 2

    @staticmethod
    def step(f: Flow, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
        k1 = f(x, u0, t)
        k2 = f(x + h * k1, u1, t + h)
        return x + h / 2 * (k1 + k2)


class RK4(OneStep):
    """Kutta's method: order 4. Hairer, Nørsett, Wanner, Table II.1.2.

    The order holds for u that is given between the nodes. A loop gives means over the nodes' cells: there it is about 3
    where u is smooth, and 2 across a jump.
    """

    name, order, steps_of_pair = "rk4", 4, 1

    @staticmethod
    def step(f: Flow, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
        return RK4.pair(f, x, u0, um, u1, t, h)[0]

    @classmethod
    def pair(cls, f: Flow, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> tuple[Array, Array]:
        """x(t + h), and how far that is from the midpoint rule, which takes the first two slopes: of order h³."""
        k1 = f(x, u0, t)
        k2 = f(x + h / 2 * k1, um, t + h / 2)
        k3 = f(x + h / 2 * k2, um, t + h / 2)
        k4 = f(x + h * k3, u1, t + h)
        y = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return y, y - (x + h * k2)
