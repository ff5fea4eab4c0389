"""Semi-implicit steps of mechanics, as physics engines take them, extrapolated to order 2."""

from collections.abc import Callable
from functools import partial

import numpy as np

from npred.formulas import Array, Value, called_functions, ldl
from npred.formulas.called_functions import whole
from npred.formulas.trace import Trace
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods.base import OneStep


class SemiImplicit(OneStep):
    """Steps that are implicit in the damping of joints: for M(q) v' = force(q, v, u, t) - damping v, q' = v,

        (M + h damping) v(t + h) = M v + h force,   q(t + h) = q + h v(t + h).

    One chain of steps h and one of steps h / 2 run over the nodes, and P is twice the second less the first: order 2,
    by three factorisations per node of a symmetric matrix half as large as the state, stable at any h where damping is
    what is stiff. The force reads the mean of u over its step. As an integrator each step is extrapolated by
    itself, which has the same order only where steps are short beside the plant's time constants.
    Hairer, Wanner, Solving Ordinary Differential Equations II, sec. IV.9. For plants that declare `mechanics`; raises
    ConfigError for others, and where those do not agree with f.
    """

    name, order = "semi_implicit", 2
    paired = False  # a step by itself has a lower order where the plant is stiff

    def __init__(self, plant: Plant, nx: int = 101):
        super().__init__(plant, nx)
        plant.check_mechanics()

    def compile(self) -> Callable[..., None]:
        return problem_of(self.plant).paired(self.chains)

    def cells(self) -> Callable[..., None]:
        return problem_of(self.plant).paired(self.chains, cells=True)

    @classmethod
    def operations(cls, plant: Plant) -> int:
        return called_functions.operations(plant, "step", cls.chains)

    @staticmethod
    @partial(whole, chains=2)
    def chains(f: Trace, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
        """Both chains a node further: x and the result have one after the other."""
        n, first, second = len(x) // 2, 0.5 * (u0 + um), 0.5 * (um + u1)
        half = _advanced(f, x[n:], first, t, 0.5 * h)
        once = _advanced(f, x[:n], 0.5 * (first + second), t, h)
        return np.concatenate([once, _advanced(f, half, second, t + 0.5 * h, 0.5 * h)])

    @staticmethod
    @whole
    def step(f: Trace, x: Array, u0: Array, um: Array, u1: Array, t: Value, h: Value) -> Array:
        both = SemiImplicit.chains(f, np.concatenate([x, x]), u0, um, u1, t, h)
        return 2.0 * both[len(x) :] - both[: len(x)]


def _advanced(f: Trace, x: Array, u: Array, t: Value, h: Value) -> Array:
    """One semi-implicit step."""
    at = f.mechanics(x, u, t)
    size, rates = range(len(at.rates)), [x[k] for k in at.rates]
    below = [[at.inertia[max(i, j)][min(i, j)] for j in size] for i in size]
    damped = [[a + h * at.damping[i] if i == j else a for j, a in enumerate(row)] for i, row in enumerate(below)]
    moments = [ldl.total(a * rate for a, rate in zip(row, rates, strict=True)) for row in below]
    after = ldl.solve(damped, [moment + h * force for moment, force in zip(moments, at.force, strict=True)])
    y = np.array(x, dtype=object)
    for position, rate, speed in zip(at.positions, at.rates, after, strict=True):
        y[position], y[rate] = x[position] + h * speed, speed
    return y
