"""The kernel of the safety filter: a condition on U for each limit of a plant, and the nearest U that keeps them."""

from functools import cache

import numpy as np

from npred.base import randomness
from npred.base.errors import ConfigError
from npred.formulas import Value, programs
from npred.formulas.tape import names
from npred.formulas.trace import Trace, python
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton
from npred.laws.design import MOMENTS, SAMPLES, SPAN, acts
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.delays import problem


@cache
def kernel(plant: Plant, ends: int) -> Kernel:
    """PROTECT of a plant, for so many predicted states. Raises ConfigError for limits that no input moves in a way
    that is linear in it.
    """
    n, m, of = plant.n, plant.m, Formulas(plant, ())
    x, u, t, alpha = of.trace.vector("x", n), of.trace.vector("u", m), of.trace.input("t"), of.trace.input("alpha")
    limits = [*of.trace.safe(x, t)]
    phi = [_barrier(of.trace, plant, k, h, x, u, t, alpha) for k, h in enumerate(limits)]
    along = of.trace.f(x, u, t)
    by_input = [programs.derivative(phi, [*u], [*unit]) for unit in np.eye(m)]
    by_state = [programs.derivative(phi, [*x], programs.derivative([*along], [*u], [*unit])) for unit in np.eye(m)]
    a, pull = ([column[k] for k in range(len(phi)) for column in columns] for columns in (by_input, by_state))
    arguments = [vector("x", n), vector("u", m), "t", "alpha"]
    results = {"h": len(limits), "phi": len(phi), "a": len(a), "pull": len(pull)}
    functions = {"BARRIER": of.function([*limits, *phi, *a, *pull], arguments, results, "one"), "FLOW": of.f()}
    rows = 2 * ends * len(limits) + 2 * m
    sizes = {"N": n, "M": m, "K": len(limits), "ENDS": ends, "ROWS": rows}
    return made("protect", problem.PROTECT, skeleton("nearest.h") + skeleton("protect.h"), functions, sizes)


def _barrier(
    trace: Trace, plant: Plant, k: int, h: Value, x: np.ndarray, u: np.ndarray, t: Value, alpha: Value
) -> Value:
    """φ(x, U) = ψ' + α ψ of limit k, ψ the first of its chain whose derivative U moves on the box."""
    along, psi, degree = trace.f(x, u, t), h, _degree(plant, k)[0]
    for order in range(1, degree + 1):
        [rate] = programs.derivative([psi], [t, *x], [1.0, *along])
        if order < degree and programs.depends([rate], [*u]):
            [rate] = programs.derivative([psi], [t, *x], [1.0, *trace.f(x, np.zeros(plant.m), t)])
        psi = rate + alpha * psi
    slopes = [programs.derivative([psi], [*u], [*unit])[0] for unit in np.eye(plant.m)]
    if programs.depends(slopes, [*u]):
        what = f"expected limits whose derivative is linear in the input, that of number {k} is not"
        raise ConfigError(f"{plant.location('safe')} {what}; let another state be the input, by its rate")
    return psi


def assumed(plant: Plant) -> list[str]:
    """The parameters without whose values U would move an earlier derivative of a limit: 0, say."""
    decisive = {name for k in range(plant.limits) for name in _degree(plant, k)[1]}
    return [name for name in plant.parameters if name in decisive]


def _degree(plant: Plant, k: int) -> tuple[int, list[str]]:
    """The first derivative of limit k by the time that U moves on the box, and the parameters that decide it."""
    trace = Trace(plant)
    x, u, t = trace.symbols()
    along, still = trace.f(x, u, t), trace.f(x, np.zeros(plant.m), t)
    pairs = [plant.box.get(name, (a - 1, a + 1)) for name, a in zip(plant.states, plant.guess, strict=True)]
    low, high = np.array(pairs, dtype=float).T  # 1 around the guess where the box has no range
    X = randomness.generator(0, "laws").uniform(low, high, (SAMPLES, plant.n))
    times = np.resize(np.linspace(0.0, plant.period or SPAN, MOMENTS, endpoint=False), SAMPLES)
    limits = inputs.bounds(plant, None)
    limits = np.where(np.isfinite(limits), limits, [-1.0, 1.0])
    U = randomness.generator(0, "limits").uniform(limits[:, 0], limits[:, 1], (SAMPLES, plant.m))
    y, decide = trace.safe(x, t)[k], []
    for degree in range(1, plant.n + 1):
        [rate] = programs.derivative([y], [t, *x], [1.0, *along])
        slopes = [programs.derivative([rate], [*u], [*unit])[0] for unit in np.eye(plant.m)]
        [y] = programs.derivative([y], [t, *x], [1.0, *still])
        symbolic = [*names("x", plant.n), *names("u", plant.m), "t", *names("p", len(plant.p))]
        with np.errstate(all="ignore"):
            columns = python([*slopes, y], symbolic)(*X.T, *U.T, times, *plant.p)
        rates = np.stack([np.broadcast_to(a, times.shape) for a in columns], axis=-1).astype(float)  # the last: U = 0
        if acts(rates[:, :-1] * np.abs(limits).max(axis=1), rates[:, -1]):
            return degree, decide
        symbols = zip(plant.parameters, trace.parameters, strict=True)
        decide += [name for name, symbol in symbols if programs.depends(slopes, [symbol])]
    what = f"expected limits that the input moves, it does not move number {k}"
    raise ConfigError(f"{plant.location('safe')} {what}; drop that one")
