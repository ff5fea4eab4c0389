"""The rest of a set-point, X* and U* with f(X*, U*) = 0 and setpoint(X*) = 0, which a law reads as parameters."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from npred.base import randomness, source_lines
from npred.base.errors import ConfigError
from npred.base.progress import say
from npred.formulas import array_math, programs
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants import newton

SETTLE = "q, p, units, &z, &arrived, &kept"  # the arguments of the kernel, as npred/kernels/c/rest.h has them
STARTS = 16  # random ones in the box, where the search from `guess` finds no rest
ROUNDING = 1e-9  # of the size of a state or an input: this close to a bound it is on it


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


def kernel(plant: Any) -> Kernel:
    """Newton's steps to the rest, the same in C and in an export. Raises ConfigError for functions that have none."""
    if not plant.traced:
        cure = "trace the plant, or drop setpoint"
        raise ConfigError(f"plant {plant.name}: setpoint expected a plant that is traced, got traced = False; {cure}")
    formulas, n, m, count = Formulas(plant, called=()), plant.n, plant.m, len(plant.parameters)
    trace = formulas.trace
    z, t = trace.vector("z", n + m), trace.input("t")
    g, of_rest = [*trace.f(z[:n], z[n:], t), *trace.setpoint(z[:n], t)], trace.parameters[count:]
    if programs.depends(g, [t, *of_rest]):
        what = "expected f and setpoint free of t and of the rest itself, got others"
        raise ConfigError(f"plant {plant.name}: setpoint {what}; declare reference(t, p, M), or drop setpoint")
    safe = [*trace.safe(z[:n], t)] if plant.declares_safe else []
    safe = [limit for limit in safe if not programs.depends([limit], [t, *of_rest])]  # others are none of a rest alone
    slope = programs.derivative(g, z, trace.vector("v", n + m))
    state, along = vector("z", n + m, "1"), vector("v", n + m, "1")
    texts = {"SLOPE": formulas.function([*g, *slope], [state, along], {"y": n + m, "dy": n + m}, "1")}
    texts |= {"SAFE": formulas.function(safe, [state], {"y": len(safe)}, "1")} if safe else {}
    sizes = {"N": n, "M": m, "PARAMETERS": max(count, 1), "LIMITS": len(safe)}
    return made("settle", SETTLE, skeleton("rest.h"), texts, sizes, exact=True)


class Rest(NamedTuple):
    """X* and U* as z (n + m,), and the smallest limit of `safe` there: NaN if one is NaN, infinity without limits."""

    z: np.ndarray
    kept: float


def settled(plant: Any, q: np.ndarray, p: np.ndarray, z: np.ndarray) -> Rest | None:
    """The rest of the parameters p, from z on, which is that of the parameters q; None where the way there ends."""
    z, arrived, kept = np.array(z), np.zeros(1), np.zeros(1)
    plant.settle(q, p, plant.scales, z, arrived, kept)
    return Rest(z, kept[0]) if arrived[0] and np.isfinite(z).all() else None


def searched(plant: Any, p: np.ndarray) -> Iterator[Rest]:
    """Rests of the parameters p, as they are found from `guess` and from random states of the box."""
    draws, around = randomness.generator(0, "rest"), np.append(plant.guess, np.zeros(plant.m))
    ends = np.stack([around - plant.scales, around + plant.scales], axis=1)
    declared = [*(plant.box.get(name) for name in plant.states), *(plant.input_bounds or [None] * plant.m)]
    for k, pair in enumerate(declared):
        ends[k] = ends[k] if pair is None or not np.isfinite(pair).all() else pair
    low, high = ends.T
    for k in range(STARTS + 1):
        z = draws.uniform(low, high)
        z[: plant.n] = z[: plant.n] if k else plant.guess
        if k % 2 == 0:  # else any input: f need not have a slope at 0 or where that slope leads
            z[plant.n :] = _nearly_held(plant, p, z[: plant.n])
        rest = settled(plant, p, p, z)
        if rest is not None:
            yield rest


def bounds(plant: Any, of_inputs: np.ndarray, rounding: float = ROUNDING) -> np.ndarray:
    """The ranges of X* and U*, (n + m, 2): `state_bounds`, and those of the inputs (m, 2), each with its rounding."""
    free = (-np.inf, np.inf)
    ranges = [*(plant.state_bounds.get(name, free) for name in plant.states), *of_inputs]
    return np.array(ranges) + rounding * np.outer(plant.scales, [-1.0, 1.0])


def beyond(plant: Any, z: np.ndarray, limits: np.ndarray) -> str:
    """Those of X* and U* that are outside the limits (n + m, 2) of `bounds`, as text: q = 12; "" for none."""
    outside = (z < limits[:, 0]) | (z > limits[:, 1])
    names = (*plant.states, *plant.inputs)
    return source_lines.values([names[k] for k in np.flatnonzero(outside)], z[outside]) if outside.any() else ""


def first(plant: Any, p: np.ndarray) -> np.ndarray:
    """X* and U* (n + m,) of the set-point of the parameters p, from `guess`, else from random states of the box.

    Raises ConfigError where no search ends, and where the rest is beyond `state_bounds`.
    """
    free = np.tile([-np.inf, np.inf], (plant.m, 1))
    limits = bounds(plant, free if plant.input_bounds is None else np.array(plant.input_bounds, dtype=float))
    rests = []
    for rest in searched(plant, p):
        if not beyond(plant, rest.z, limits):
            return rest.z
        rests.append(rest.z)
    of_states = bounds(plant, free)
    for z in rests:  # an input beyond its bounds is the law's to refuse
        if not beyond(plant, z, of_states):
            return z
    values = source_lines.values([*plant.parameters], p[: len(plant.parameters)])
    what = f"expected a rest of the set-point, found none near guess = {plant.guess.tolist()} for {values}"
    if rests:
        what = f"expected a rest within state_bounds for {values}, got {beyond(plant, rests[0], of_states)}"
    raise ConfigError(f"{plant.location('setpoint')} {what}; move guess, or the parameters")


def _nearly_held(plant: Any, p: np.ndarray, X: np.ndarray) -> np.ndarray:
    """The input (m,) with the least f at X, by one Gauss-Newton step from 0; zeros where f or f_U is not known."""
    u, p = np.zeros(plant.m), p.tolist()
    with np.errstate(all="ignore"):
        try:
            f = np.array(plant.call("f", X.tolist(), u.tolist(), 0.0, p, array_math.NUMPY), dtype=float)
            f_U = np.array(plant.derivatives["f_u"](*X, *u, 0.0, *p), dtype=float).reshape(plant.m, plant.n).T
        except (ArithmeticError, ValueError):
            return u
    return newton.best_input(f, f_U, plant.scales[: plant.n])


def changed(
    plant: Any, p: np.ndarray, values: Mapping[str, float], fixed: Mapping[str, str], limits: np.ndarray
) -> np.ndarray:
    """The numbers p with other parameters, and with their rest, followed from the last one; says the smallest limit of
    `safe` there where it is broken.

    `fixed` says of those that cannot be set why. Raises ConfigError for such a one, for a value that is not finite, and
    where no rest follows that is within the limits of `bounds`.
    """
    p, before, count = p.copy(), p, len(plant.parameters)
    for name, value in values.items():
        if name in fixed:
            raise ConfigError(f"set: expected a parameter that can be set, got {name!r}: {fixed[name]}")
        p[list(plant.parameters).index(name)] = value
    if np.array_equal(p, before) or not plant.declares_setpoint:
        return p
    rest = settled(plant, before, p, p[count:])
    outside = "" if rest is None else beyond(plant, rest.z, limits)
    shown = ", ".join(f"{name} = {value:g}" for name, value in values.items())
    if rest is None or outside:
        others = (other.z for other in searched(plant, p) if not beyond(plant, other.z, limits))
        z = next(others, None)
        names = (*plant.states, *plant.inputs)
        cure = "choose another"
        if z is not None:
            guess = [float(f"{value:.4g}") for value in z[: plant.n]]
            cure = f"another branch rests with {source_lines.values(names, z)}; to use it, start there: guess = {guess}"
        what = f"expected a rest within its bounds for {shown}, {f'got {outside}' if outside else 'found none'}"
        raise ConfigError(f"set: {what}; the old set-point stays, {cure}")
    p[count:] = rest.z
    if not rest.kept >= 0:
        near = ", ".join(f"{name} = {value:.3g}" for name, value in values.items())  # so few that each can be said
        what = f"expected a rest where safe is at least 0, got {rest.kept:.2g}"
        say(f"set: {near}: {what}; choose another, or let npred.SafetyFilter keep off it")
    return p
