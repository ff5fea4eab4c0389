"""Euler's method."""

from typing import Any

from npred.predictors.onestep import OneStep


class Euler(OneStep):
    """x + h f(x, u): order 1, the paper's scheme."""

    name, order = "euler", 1

    @staticmethod
    def step(f: Any, x: Any, u0: Any, um: Any, u1: Any, t: Any, h: Any) -> Any:
        return x + h * f(x, u0, t)
