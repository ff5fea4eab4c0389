"""One-step methods: a formula for the step, which the plant's family of kernels sweeps over the nodes."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from npred.delays import family_of
from npred.predictors.base import Compiled


class OneStep(Compiled):
    """x_{j+1} = step(x_j): `step` is the method's formula on arrays, of the declared order for smooth u."""

    @staticmethod
    @abstractmethod
    def step(f: Callable[..., Any], x: Any, u0: Any, um: Any, u1: Any, t: Any, h: Any) -> Any:
        """x(t + h) from x(t), the input being u0, um, u1 at t, t + h/2, t + h."""

    def compile(self) -> Callable[..., None]:
        return family_of(self.plant).sweep(self.step)
