"""One-step methods: a formula for the step, which the plant's family of kernels sweeps over the nodes."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from npred.delays import family_of
from npred.errors import ConfigError
from npred.plants.base import Plant
from npred.predictors.base import Compiled
from npred.symbolic import called_functions, source_lines

Array: TypeAlias = np.ndarray  # of numbers or symbols: states (n,) and inputs (m,), or the same with lanes, (n, B)
Time: TypeAlias = Any  # a number, a symbol, or the numbers of lanes (B,)
Flow: TypeAlias = Callable[..., Array]  # f(x, u, t); of an implicit step a Trace, which knows derivatives too


class OneStep(Compiled):
    """x_{j+1} = step(x_j): `step` is the method's formula on arrays, of the declared order for smooth u.

    Raises ConfigError for a plant that the method does not serve.
    """

    def __init__(self, plant: Plant, nx: int = 101):
        super().__init__(plant, nx)
        family_of(plant).needs(self.name)

    @staticmethod
    @abstractmethod
    def step(f: Flow, x: Array, u0: Array, um: Array, u1: Array, t: Time, h: Time) -> Array:
        """x(t + h) from x(t), the input being u0, um, u1 at t, t + h/2, t + h."""

    @classmethod
    def evaluations(cls) -> int:
        """Evaluations of f per step. Raises ConfigError, with the line, for a formula that fails or is no step."""
        times = []

        def f(x: Array, u: Array, t: Time) -> Array:
            times.append(t)
            return -x

        x, u, step = np.ones(2), np.zeros(1), f"predictor {cls.__name__}: step ({source_lines.line(cls.step)})"
        try:
            y = np.asarray(cls.step(f, x, u, u, u, 0.0, 0.1), dtype=float)
        except Exception as error:
            where, reason = source_lines.where(error, cls.step), source_lines.one_line(error)
            raise ConfigError(f"{step} failed{where}: {reason}; use array arithmetic alone") from None
        if y.shape != x.shape or not times:
            returned = f"{y.shape} after {len(times)} evaluations of f"
            expected = "expected to evaluate f and to return the state, shape (n,)"
            raise ConfigError(f"{step} {expected}, got {returned}; return x + h * f(x, u0, t), say")
        return len(times)

    def compile(self) -> Callable[..., None]:
        return family_of(self.plant).sweep(self.step)

    def cells(self) -> Callable[..., None]:
        """The compiled map for inputs that are a straight line on each cell: family.PREDICT with `cells`."""
        return family_of(self.plant).sweep(self.step, cells=True)  # type: ignore[call-arg]

    @classmethod
    def operations(cls, plant: Plant) -> int:
        """The operations of a step, counted in its program."""
        return called_functions.operations(plant, cls.step)

    def call_operations(self, steps: int) -> int:
        """The operations of a call of so many steps."""
        return steps * self.operations(self.plant)
