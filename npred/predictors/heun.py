"""Heun's method."""

from typing import Any

from npred.predictors.onestep import OneStep


class Heun(OneStep):
    """The trapezoidal rule with Euler's step as its end point: order 2. Hairer, Nørsett, Wanner, Table II.1.1."""

    name, order = "heun", 2

    @staticmethod
    def step(f: Any, x: Any, u0: Any, um: Any, u1: Any, t: Any, h: Any) -> Any:
        k1 = f(x, u0, t)
        k2 = f(x + h * k1, u1, t + h)
        return x + h / 2 * (k1 + k2)
