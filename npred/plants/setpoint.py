"""The rest of a set-point, X* and U* with f(X*, U*) = 0 and setpoint(X*) = 0, which a law reads as parameters."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from npred.base import randomness, source_lines
from npred.base.errors import ConfigError
from npred.formulas import array_math, programs
from npred.formulas.declared import Declared
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton

SETTLE = "p, &z, &arrived"  # the arguments of the kernel, as npred/kernels/c/rest.h has them
STARTS = 16  # random ones in the box, where the search from `guess` finds no rest


class ReadOnly(dict[str, float]):
    """Parameters of a plant: a change of them would change nothing, so it is refused."""

    def _refuse(self, *_: Any, **__: Any) -> Any:
        cure = "write npred.plant(…, aim=2), or controller.set(aim=2) while it runs"
        raise ConfigError(f"plant.parameters: expected to be read only, got a change; {cure}")

    __setitem__ = __delitem__ = __ior__ = update = setdefault = pop = popitem = clear = _refuse  # type: ignore

    def __reduce__(self) -> Any:
        return dict, (dict(self),)


def of_rest(states: tuple[str, ...], inputs: tuple[str, ...]) -> tuple[str, ...]:
    """The names of the parameters that X* and U* are."""
    return tuple(f"rest_{name}" for name in (*states, *inputs))


def kernel(plant: Declared) -> Kernel:
    """Newton's steps to the rest, the same in C and in an export. Raises ConfigError for functions that have none."""
    if not plant.traced:
        cure = "trace the plant, or drop setpoint"
        raise ConfigError(f"plant {plant.name}: setpoint expected a plant that is traced, got traced = False; {cure}")
    formulas, n, m = Formulas(plant, called=()), plant.n, plant.m
    trace = formulas.trace
    z, t = trace.vector("z", n + m), trace.input("t")
    g = [*trace.f(z[:n], z[n:], t), *trace.setpoint(z[:n], t)]
    if programs.depends(g, [t, *trace.parameters[len(plant.parameters) :]]):
        what = "expected f and setpoint free of t and of the rest itself, got others"
        raise ConfigError(f"plant {plant.name}: setpoint {what}; declare reference(t, p, M), or drop setpoint")
    slope = programs.derivative(g, z, trace.vector("v", n + m))
    arguments = [vector("z", n + m, "1"), vector("v", n + m, "1")]
    text = formulas.function([*g, *slope], arguments, {"y": n + m, "dy": n + m}, "1")
    return made("settle", SETTLE, skeleton("rest.h"), {"SLOPE": text}, {"N": n, "M": m}, exact=True)


def settled(plant: Any, p: np.ndarray, z: np.ndarray) -> np.ndarray | None:
    """X* and U* (n + m,) of the parameters p, from z on; None where there is none that the search finds."""
    z, arrived = np.array(z), np.zeros(1)
    plant.settle(p, z, arrived)
    return z if arrived[0] and np.isfinite(z).all() else None


def first(plant: Any, p: np.ndarray) -> np.ndarray:
    """X* and U* (n + m,) of the declared set-point, from `guess`, else from random states of the box.

    Raises ConfigError where no search ends.
    """
    p, draws = np.append(p, np.zeros(plant.n + plant.m)), randomness.generator(0, "rest")
    low, high = np.array([plant.box.get(name, (-1.0, 1.0)) for name in plant.states]).T
    for k in range(STARTS + 1):
        X = draws.uniform(low, high) if k else plant.guess
        z = settled(plant, p, np.append(X, _nearly_held(plant, p, X)))
        if z is not None:
            return z
    values = source_lines.values([*plant.parameters], p[: len(plant.parameters)])
    what = f"expected a rest of the set-point, found none near guess = {plant.guess.tolist()} for {values}"
    raise ConfigError(f"{plant.location('setpoint')} {what}; move guess, or the parameters")


def _nearly_held(plant: Any, p: np.ndarray, X: np.ndarray) -> np.ndarray:
    """The input (m,) with which f is least at X, by one Gauss-Newton step from 0; zeros where f is not defined."""
    u, p = np.zeros(plant.m), p.tolist()
    with np.errstate(all="ignore"):
        try:
            f = np.array(plant.call("f", X.tolist(), u.tolist(), 0.0, p, array_math.NUMPY), dtype=float)
            f_U = np.array(plant.derivatives["f_u"](*X, *u, 0.0, *p), dtype=float).reshape(plant.m, plant.n).T
        except (ArithmeticError, ValueError):
            return u
    return -np.linalg.lstsq(f_U, f, rcond=None)[0] if np.isfinite(f).all() and np.isfinite(f_U).all() else u


def changed(
    plant: Any, p: np.ndarray, values: Mapping[str, float], fixed: Mapping[str, str], bounds: np.ndarray
) -> np.ndarray:
    """The numbers p with other parameters, and with their rest, found from the last one.

    `fixed` says of those that cannot be set why. Raises ConfigError for such a one, for a value that is not finite, and
    where there is no rest with an input within `bounds` (m, 2).
    """
    p, before, count = p.copy(), p, len(plant.parameters)
    for name, value in values.items():
        if name in fixed:
            raise ConfigError(f"set: expected a parameter that can be set, got {name!r}: {fixed[name]}")
        p[list(plant.parameters).index(name)] = value
    if np.array_equal(p, before) or not plant.declares_setpoint:
        return p
    z, shown = settled(plant, p, p[count:]), ", ".join(f"{name} = {value:g}" for name, value in values.items())
    U = None if z is None else z[plant.n :]
    if U is None or (np.clip(U, *bounds.T) != U).any():
        came = "found none" if U is None else f"got {source_lines.values(plant.inputs, U)}"
        what = f"expected a rest with an input within its bounds for {shown}, {came}"
        raise ConfigError(f"set: {what}; the old set-point stays, choose another")
    p[count:] = z
    return p
