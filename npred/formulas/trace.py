"""A plant's functions on one tape, and programs of them printed as plain Python."""

from collections.abc import Callable, Collection, Sequence
from numbers import Real
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from npred.base.errors import ConfigError
from npred.formulas import Value, programs, tables
from npred.formulas import tape as tapes
from npred.formulas.declared import RETURNS, Declared


class Mechanics(NamedTuple):
    """M(q) v' = force - damping v, q' = v, of a plant that declares it.

    `positions` and `rates` are the numbers of the states q_i and v_i; inertia (k, k) is symmetric positive definite,
    force (k,) has all but the damping (k,), one coefficient of each rate.
    """

    positions: list[int]
    rates: list[int]
    inertia: list[list[Value]]
    force: list[Value]
    damping: list[Value]


class Trace:
    """f, kappa, V and their directional derivatives as expressions: vectors are object arrays of symbols.

    Formulas (a predictor's step, the update law) are written once on arrays; run on a trace they become programs.
    Functions whose names are in `called` are not written out in those, but called: see npred.formulas.called_functions.
    """

    def __init__(self, plant: Declared, called: Collection[str] = ()) -> None:
        self.plant: Value = plant
        self.called = called
        self.steps: dict[str, Callable[..., Any]] = {}  # formulas that are called, by the names of the functions
        self.tape = tapes.Tape()
        self.parameters = self.tape.inputs("p", len(plant.p_names))

    def input(self, name: str) -> tapes.Symbol:
        """A scalar input of the program."""
        return self.tape.input(name)

    def vector(self, prefix: str, size: int) -> np.ndarray:
        """The vector input prefix0, prefix1, … of the program, shape (size,)."""
        return np.array(self.tape.inputs(prefix, size), dtype=object)

    def symbols(self) -> tuple[np.ndarray, np.ndarray, tapes.Symbol]:
        """The inputs x (n,), u (m,) and t of the plant's functions."""
        return self.vector("x", self.plant.n), self.vector("u", self.plant.m), self.input("t")

    def f(self, x: np.ndarray, u: np.ndarray, t: Value) -> np.ndarray:
        """f(x, u, t), shape (n,)."""
        return self._call("f", self.plant.n, x, u, t)

    __call__ = f  # a step reads f of a trace, and, where it is implicit, more

    def kappa(self, x: np.ndarray, t: Value) -> np.ndarray:
        """kappa(x, t), shape (m,)."""
        return self._call("kappa", self.plant.m, x, None, t)

    def V(self, x: np.ndarray, t: Value) -> Value:
        """V(x, t), a scalar."""
        return self._call("V", 1, x, None, t)[0]

    def delay(self, x: np.ndarray, t: Value) -> Value:
        """delay(x, t) in seconds, a scalar."""
        return self._call("delay", 1, x, None, t)[0]

    def output(self, x: np.ndarray, t: Value) -> np.ndarray:
        """output(x, t), the measured outputs, shape (outputs,)."""
        return self._call("output", len(self.plant.outputs), x, None, t)

    def safe(self, x: np.ndarray, t: Value) -> np.ndarray:
        """safe(x, t), limits that are at least 0 where the state is safe, shape (limits,)."""
        return self._call("safe", self.plant.limits, x, None, t)

    def setpoint(self, x: np.ndarray, t: Value) -> np.ndarray:
        """setpoint(x, t), what is 0 at the rest that the law leads to, shape (m,)."""
        return self._call("setpoint", self.plant.m, x, None, t)

    def reference(self, t: Value) -> np.ndarray:
        """reference(t), shape (n,)."""
        return self._call("reference", self.plant.n, None, None, t)

    def mechanics(self, x: np.ndarray, u: np.ndarray, t: Value) -> Mechanics:
        """M(q), force and damping at x, u, t. Raises ConfigError where their shapes do not fit the plant's states."""
        state, inputs, time = self.symbols()
        by_node = {symbol.index: k for k, symbol in enumerate(state)}
        velocity = enumerate(self.f(state, inputs, time))  # positions are the states whose derivative is another state
        pairs = [(k, by_node[v.index]) for k, v in velocity if getattr(v, "index", None) in by_node]
        positions, rates = [k for k, _ in pairs], [j for _, j in pairs]
        values = self.plant.call("mechanics", list(x), list(u), t, self.parameters, tapes.M)
        shapes = [np.shape(np.array(value, dtype=object)) for value in values]
        size = len(rates)
        if not size or shapes != [(size, size), (size,), (size,)]:
            raise ConfigError(
                f"{self.plant.location('mechanics')} expected to return M ({size}, {size}), force ({size},) and "
                f"damping ({size},), one row per state that is the rate of another, got {shapes}; return such lists"
            )
        inertia, force, damping = values
        return Mechanics(positions, rates, [list(row) for row in inertia], list(force), list(damping))

    def df(self, x: np.ndarray, u: np.ndarray, t: Value, v: np.ndarray, dt: Value = 0.0) -> np.ndarray:
        """f_X v + f_t dt, the change of f(x, u, t) as x moves along v and t by dt, both input symbols, shape (n,)."""
        return np.array(programs.derivative(self.f(x, u, t), [t, *x], [dt, *v]), dtype=object)

    def dkappa(self, x: np.ndarray, t: Value, v: np.ndarray, dt: Value = 0.0) -> np.ndarray:
        """kappa_X v + kappa_t dt, the change of kappa(x, t), likewise, shape (m,)."""
        return np.array(programs.derivative(self.kappa(x, t), [t, *x], [dt, *v]), dtype=object)

    def law(self, x: np.ndarray, t: Value, v: np.ndarray, dt: Value = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """kappa(x, t) and its change along (v, dt), in one call where kappa is called."""
        if "kappa" not in self.called:
            return self.kappa(x, t), self.dkappa(x, t, v, dt)
        both = self.tape.call("law", [t, *x, *self.parameters, dt, *v], 0, 2 * self.plant.m)
        return np.array(both[: self.plant.m], dtype=object), np.array(both[self.plant.m :], dtype=object)

    def _call(self, name: str, size: int, x: np.ndarray | None, u: np.ndarray | None, t: Value) -> np.ndarray:
        if name in self.called:
            args = [t, *(() if x is None else x), *(() if u is None else u), *self.parameters]
            return np.array(self.tape.call(name, args, 1 + self.plant.n, size), dtype=object)
        state, inputs = (None if part is None else list(part) for part in (x, u))
        values = self.plant.call(name, state, inputs, t, self.parameters, tapes.M)
        for value in values:
            if not isinstance(value, tapes.Symbol | Real):
                what = f"{self.plant.location(name)} expected to return numbers and formulas"
                cure = f"return {RETURNS[name]}"
                raise ConfigError(f"{what}, got {type(value).__name__}; {cure}")
        if len(values) != size:
            count = f"{size} value{'s' * (size > 1)}"
            names = ", ".join(self.plant.inputs if name in ("kappa", "setpoint") else self.plant.states)
            cure = f"return {RETURNS[name]}: {names}"
            raise ConfigError(f"{self.plant.location(name)} expected to return {count}, got {len(values)}; {cure}")
        return np.array(values, dtype=object)


ON_ARRAYS = {name: f"np.{name}({{0}}, {{1}})" for name in ("maximum", "minimum", "logical_and", "logical_or")}
ON_ARRAYS |= {"where": "np.where({0}, {1}, {2})", "logical_not": "np.logical_not({0})"}


def python(outputs: tapes.Vector, names: Sequence[str], library: ModuleType = np) -> Callable[..., list[Value]]:
    """The program as an interpreted function of the named inputs, on numbers, arrays, or their like.

    A branch that M.where does not take may be undefined there, as in the compiled kernels. With `library` math it is
    for Python's own floats, which is quicker, and raises where they do.
    """
    targets = tapes.names("y", len(outputs))
    lines = programs.lines(outputs, {}, targets, ON_ARRAYS if library is np else {})
    text = f"def function({', '.join(names)}):\n    " + "\n    ".join(lines) + f"\n    return [{', '.join(targets)}]"
    space: dict[str, Any] = {"math": library, "np": np, "interp": tables.interp}
    for name, called in next((y.tape.networks for y in outputs if isinstance(y, tapes.Symbol)), {}).items():
        space |= {f"plant_{name}": called, f"plant_d{name}": called.tangents}
    exec(text, space)
    return space["function"]
