"""A plant: its author's declaration, its equilibrium, its functions on arrays, and their texts."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from npred.base import randomness, registry, source_lines
from npred.base.errors import ConfigError
from npred.base.notebook import InNotebook
from npred.base.registry import Source
from npred.formulas import Array, Value, array_math, programs
from npred.formulas.declared import Components, call
from npred.formulas.tape import Functions, names
from npred.formulas.trace import Trace, python
from npred.kernels.kernel import Kernel
from npred.plants import declaration as declared
from npred.plants import newton, setpoint


class Plant(InNotebook):
    """X'(t) = f(X(t), U(t - D)) with the control law kappa and the function V [DAPF, eqs. 1-4].

    A declaration is a class with `states`, `inputs` (names) and the functions f(x, u, t, p, M), kappa(x, t, p, M) and
    V(x, t, p, M); optional are `parameters` (name to default), `box` (state to range, for experiments), `guess` (where
    the equilibrium is searched from), `input_bounds` (a range per input), `state_bounds` (state to the range in which
    it stops, as if a wall were there), `delays` (seconds, one per input, where they differ), `mechanics` (M(q), force
    and damping of M q'' = force - damping q', for the method semi_implicit), what figures write: `labels` and `units`
    (by state or input), `time_unit` ("s" by default) and `figure` (that of an article which the evaluated loop is),
    and, where f or kappa depends on time, `reference(t, p, M)`, the trajectory that kappa follows, and `period`, the
    time after which they repeat; or `setpoint(x, t, p, M)`, one value per input, all 0 where it is to rest: then
    kappa may read that rest, as p.rest_<state> and p.rest_<input>. M provides the functions: sin, exp, where … A law
    `kappa` that is passed takes the place of the declaration's.

    Raises ConfigError for a declaration with a part that is missing or wrong, or a parameter that it does not have.
    """

    traced: ClassVar[bool] = True
    spec: str | None = None  # the name by which another process finds it; a class in a script has none
    law_table: Mapping[str, Any] = {}  # the name of the law that was designed for it, and what that took

    def __init__(
        self, name: str, declaration: Any, overrides: Mapping[str, float] = {}, source: Source | None = None,
        kappa: Callable[..., Any] | None = None,
    ):  # fmt: skip
        parts = declared.read(name, declaration, overrides)
        self.name, self.declaration = name, declared.completed(name, declaration, kappa)
        self.declared, self.law = declaration, kappa  # the class as written, and the law in place of its kappa
        self.declares_kappa = (kappa or parts.kappa) is not None
        self.source = source or registry.declaring(declaration)
        self.declares_V, self.declares_delay = parts.V is not None, parts.delay is not None
        self.declares_mechanics, self.declares_rollout = parts.mechanics is not None, parts.rollout is not None
        self.declares_output, self.outputs = parts.output is not None, parts.outputs or parts.states
        self.declares_safe, self.declares_setpoint = parts.safe is not None, parts.setpoint is not None
        self.states, self.inputs, self.box = parts.states, parts.inputs, parts.box
        self.parameters = setpoint.ReadOnly(parts.parameters)
        rest = setpoint.of_rest(self.states, self.inputs) if self.declares_setpoint else ()
        self.p_names = (*self.parameters, *rest)  # the names of all numbers that its functions read as p
        guess = getattr(kappa, "guess", parts.guess)  # a law that was designed has that of its rest
        self.guess = np.zeros(self.n) if guess is None else np.array(guess)
        self.input_bounds = None if parts.input_bounds is None else list(parts.input_bounds)
        self.state_bounds = parts.state_bounds
        self.delays, self.period = parts.delays, parts.period
        self.labels, self.units, self.time_unit, self.figure = parts.labels, parts.units, parts.time_unit, parts.figure

    def __repr__(self) -> str:
        parts = [f"states {_few(self.states)}", f"inputs {_few(self.inputs)}"]
        values = [f"{name} = {value:g}" for name, value in self.parameters.items()]
        return f"<{type(self).__name__} {self.name}: {'; '.join(parts + ([_few(values)] if values else []))}>"

    def controlled(self, kappa: Callable[..., Any]) -> "Plant":
        """The plant with another law kappa(x, t, p, M), one of npred.laws say. Raises ConfigError for a black box."""
        if not self.traced:
            cure = "write kappa(X, t, p) in its class"
            raise ConfigError(f"plant {self.name}: kappa expected a plant that is traced, got traced = False; {cure}")
        self.own("kappa", kappa)
        plant = type(self)(self.name, self.declared, self.parameters, self.source, kappa)
        plant.spec = self.spec
        return plant

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.states)

    @property
    def m(self) -> int:
        """The number of inputs."""
        return len(self.inputs)

    @cached_property
    def ratios(self) -> np.ndarray:
        """r_j = D_j / D in (0, 1], (m,): the delay of each input as a share of the longest, which is a loop's D."""
        return np.ones(self.m) if self.delays is None else np.array(self.delays) / max(self.delays)

    @property
    def one_delay(self) -> bool:
        """True if all inputs arrive equally late."""
        return bool((self.ratios == 1).all())

    @cached_property
    def p(self) -> np.ndarray:
        """The parameters' values in the order of their declaration, then the rest of a declared set-point."""
        p = self.p_declared.copy()
        if self.declares_setpoint:
            p[len(self.parameters) :] = setpoint.first(self, p)
        return p

    @cached_property
    def p_declared(self) -> np.ndarray:
        """The same without a search for that rest: 0 in its place."""
        values = [*self.parameters.values()]
        return np.array(values + [0.0] * (len(self.p_names) - len(values)), dtype=float)

    @cached_property
    def scales(self) -> np.ndarray:
        """How large a change of each state and input counts as one, (n + m,): half its range, where it has one."""
        return newton.scales(self)

    def ranges(self, around: np.ndarray | None = None, half: Array | float = 1.0) -> np.ndarray:
        """The box (n, 2); where it has no range for a state, `half` around a point, by default around `guess`."""
        point = self.guess if around is None else around
        pairs = zip(self.states, point - half, point + half, strict=True)
        return np.array([self.box.get(name, ends) for name, *ends in pairs], dtype=float)

    def drawn(self, purpose: str, count: int) -> np.ndarray:
        """Random states of these ranges, (count, n)."""
        low, high = self.ranges().T
        return randomness.generator(0, purpose).uniform(low, high, (count, self.n))

    @cached_property
    def settle(self) -> Kernel:
        """The search for the rest of a set-point (npred.plants.setpoint)."""
        return setpoint.kernel(self)

    def time_text(self, time: float, form: str = "g") -> str:
        """A time of the plant's clock with its unit: 0.01 h."""
        return f"{time:{form}} {self.time_unit}".rstrip()

    def location(self, name: str) -> str:
        """A declared function in words, with file and line: plant Tank: f (my_plant.py:12)."""
        line = source_lines.line(getattr(self.declaration, name))
        return f"plant {self.name}: {name}" + (f" ({line})" if line else "")

    def call(self, name: str, x: Components, u: Components, t: Value, p: Sequence[Value], M: Functions) -> list[Value]:
        """A declared function on components of any kind: floats, arrays, tensors or symbols."""
        return call(self, name, x, u, t, p, M)

    def f(self, X: Array, u: Array, t: Value = 0.0) -> Array:
        """f(X, u, t): X (..., n), u (..., m) to (..., n); lists, NumPy arrays or torch tensors."""
        return self._stacked("f", X, u, t)

    def kappa(self, X: Array, t: Value = 0.0) -> Array:
        """kappa(X, t): X (..., n) to (..., m)."""
        return self._stacked("kappa", X, None, t)

    def V(self, X: Array, t: Value = 0.0) -> Array:
        """V(X, t): X (..., n) to (...)."""
        return self._on("V", array_math.taken(X), None, array_math.taken(t))[0]

    def delay(self, X: Array, t: Value = 0.0) -> Array:
        """delay(X, t), X (..., n) to (...), of a plant that declares it. Raises ConfigError for another."""
        return self._stacked("delay", X, None, t)[..., 0]

    def output(self, X: Array, t: Value = 0.0) -> Array:
        """The outputs of X (..., n): output(X, t) (..., outputs) of a plant that declares it, else X."""
        return self._stacked("output", X, None, t) if self.declares_output else array_math.taken(X)

    def safe(self, X: Array, t: Value = 0.0) -> Array:
        """Limits that are at least 0 where X (..., n) is safe: safe(X, t) (..., limits), of a plant that declares it.

        Raises ConfigError for another plant.
        """
        return self._stacked("safe", X, None, t)

    @cached_property
    def limits(self) -> int:
        """How many numbers safe(x, t, p, M) gives; 0 where it is not declared."""
        if not self.declares_safe:
            return 0
        p = [*self.parameters.values()]
        p += [np.nan] * (len(self.p_names) - len(p))  # a formula may divide by a state or by the rest: NaN never fails
        return len(self.call("safe", [np.nan] * self.n, None, np.nan, p, array_math.NUMPY))

    def rollout(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Value) -> np.ndarray:
        """P (B, nx, n) by the simulator of a black box that declares rollout. Raises ConfigError for any other."""
        raise ConfigError(f"plant {self.name}: rollout expected traced = False and rollout(X, u, D_hat, t, p); use rk4")

    def stopped(self, x: Array, M: Functions) -> Array:
        """The components of a state after a step, each within `state_bounds`; NaN and infinity stay visible."""
        if not self.state_bounds:
            return x
        components = list(x)
        for k, name in enumerate(self.states):
            low, high = self.state_bounds.get(name, (-np.inf, np.inf))
            if low > -np.inf:
                components[k] = M.where(components[k] < low, low, components[k])
            if high < np.inf:
                components[k] = M.where(components[k] > high, high, components[k])
        return components

    def _stacked(self, name: str, X: Array, u: Array | None, t: Value) -> Array:
        """A declared function, its values as the last axis; lists are taken as arrays."""
        if not hasattr(self.declaration, name):
            raise ConfigError(f"plant {self.name}: expected {name}(x, t, p, M), found none; declare it")
        X, u, t = map(array_math.taken, (X, u, t))
        values = self._on(name, X, u, t)
        return array_math.stack(values, X[..., 0])

    def _on(self, name: str, X: Array, u: Array | None, t: Value) -> list[Value]:
        self._fits(X, u)
        x = [X[..., k] for k in range(self.n)]
        inputs = None if u is None else [u[..., k] for k in range(self.m)]
        return self.call(name, x, inputs, t, self.p.tolist(), array_math.of(X))

    def _fits(self, X: Array | None = None, u: Array | None = None) -> None:
        """Raise ConfigError unless the last axes of X and u are of the plant's sizes."""
        for name, a, size in (("X", X, self.n), ("u", u, self.m)):
            shape = tuple(getattr(a, "shape", ()))
            if a is not None and (not shape or shape[-1] != size):
                raise ConfigError(f"{name}: expected an array (..., {size}) for plant {self.name}, got {shape or a!r}")

    @cached_property
    def equilibrium(self) -> np.ndarray:
        """X* with f(X*, kappa(X*)) = 0 to machine precision, shape (n,), by Newton's method from `guess`, or from its
        set-point's rest.

        Raises ConfigError where it finds none, or where the plant depends on time: that one tracks, see `rests`.
        """
        if not self.rests:
            got = "f or kappa depends on time; it only tracks"
            raise ConfigError(f"plant {self.name}: expected a rest, but {got}")
        X = self.p[-self.n - self.m : -self.m].copy() if self.declares_setpoint else self.guess.copy()
        X, arrived = newton.search(self._at_rest, X, self.scales[: self.n])
        if not arrived:
            g, _ = self._at_rest(X)
            left = source_lines.values([f"{name}'" for name in self.states], g)
            near = f"no rest near guess = {self.guess.tolist()}: {left} is left"
            cure = "let kappa hold a point where f vanishes, or give a `guess` closer to one"
            raise ConfigError(f"{self.location('kappa')} leads to {near}; {cure}")
        return X

    @cached_property
    def u_equilibrium(self) -> np.ndarray:
        """u* = kappa(X*), shape (m,)."""
        return self.kappa(self.equilibrium)

    def target(self, t: Value) -> np.ndarray:
        """The target of kappa: the equilibrium (n,) where the plant rests, else its reference at t (...), (..., n).

        Raises ConfigError for a plant that depends on time and declares no reference.
        """
        if self.rests:
            return self.equilibrium
        if not self.tracks:
            neither = "expected a rest or a reference, found neither; declare reference(t, p, M)"
            raise ConfigError(f"plant {self.name}: {neither}")
        return self._reference(np.asarray(t, dtype=float))

    def _reference(self, t: np.ndarray) -> np.ndarray:
        return array_math.stack(self.call("reference", None, None, t, [*self.p], array_math.NUMPY), t)

    def u_target(self, t: Value) -> np.ndarray:
        """The input at the target, kappa(target(t), t): (m,) or (..., m)."""
        return self.u_equilibrium if self.rests else self.kappa(self.target(t), t)

    def check_mechanics(self) -> None:
        """Raise ConfigError unless M(q) v' = force - damping v gives the accelerations of f near `guess`."""
        draws = np.random.default_rng(0)
        X, u = self.guess + draws.standard_normal((8, self.n)), draws.standard_normal((8, self.m))
        p, columns = self.p.tolist(), [*X.T]
        trace = Trace(self)
        at = trace.mechanics(*trace.symbols())
        inertia, force, damping = self.call("mechanics", columns, [*u.T], 0.0, p, array_math.NUMPY)
        inertia = np.moveaxis(np.array([[a + np.zeros(8) for a in row] for row in inertia]), -1, 0)
        pull = [a - c * X[:, k] + np.zeros(8) for a, c, k in zip(force, damping, at.rates, strict=True)]
        expected = np.linalg.solve(inertia, np.array(pull).T[..., None])[..., 0]
        difference = np.abs(self.f(X, u)[:, at.rates] - expected).max()
        if not difference <= 1e-6 * np.abs(expected).max():
            got = f"got a difference of {difference:.3g}; make force and damping those of f"
            raise ConfigError(f"{self.location('mechanics')} expected the accelerations of f, {got}")

    def jacobians(self, X: np.ndarray, u: np.ndarray, t: Value = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """f_X (..., n, n) and f_U (..., n, m) at points X (..., n), u (..., m), derived from the declared f."""
        point = np.asarray(X), *np.moveaxis(np.asarray(u), -1, 0), t
        return self._matrix("f_x", self.n, *point), self._matrix("f_u", self.n, *point)

    def kappa_jacobian(self, X: np.ndarray, t: Value = 0.0) -> np.ndarray:
        """kappa' (..., m, n) at points X (..., n), derived from the declared kappa."""
        return self._matrix("kappa_x", self.m, np.asarray(X), t)

    def linearised(self, t: Value = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """f_X + f_U kappa' (..., n, n) and f_U (..., n, m) at the target at times t (...)."""
        X, u = self.target(t), self.u_target(t)
        f_X, f_U = self.jacobians(X, u, t)
        return f_X + f_U @ self.kappa_jacobian(X, t), f_U

    def _matrix(self, name: str, rows: int, X: np.ndarray, *more: Value) -> np.ndarray:
        """The derivatives as matrices (..., rows, columns), one column per direction."""
        with np.errstate(all="ignore"):
            values = self.derivatives[name](*np.moveaxis(X, -1, 0), *more, *self.p)
        values = array_math.stack(values, X[..., 0])
        return np.swapaxes(values.reshape(*X.shape[:-1], -1, rows), -1, -2)

    @cached_property
    def derivatives(self) -> dict[str, Callable[..., list[Value]]]:
        """f_x, f_u of the components of x, u, t, p, and kappa_x of those of x, t, p, as programs on numbers or arrays.

        Each gives the derivatives along one unit direction after the other.
        """
        trace = Trace(self)
        x, u, t = trace.symbols()
        f, rest = trace.f(x, u, t), ["t", *names("p", len(self.p_names))]
        of_f, of_kappa = [*names("x", self.n), *names("u", self.m), *rest], [*names("x", self.n), *rest]
        parts = {"f_x": (f, x, of_f), "f_u": (f, u, of_f)}
        parts |= {"kappa_x": (trace.kappa(x, t), x, of_kappa)} if self.declares_kappa else {}
        return {
            name: python([y for unit in np.eye(len(by)) for y in programs.derivative(values, by, unit)], inputs)
            for name, (values, by, inputs) in parts.items()
        }

    def _at_rest(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """f(X, kappa(X)) and its Jacobian; NaN where they are not defined, so that the search turns back."""
        try:
            with np.errstate(all="ignore"):
                u = self.kappa(X)
                f_X, f_U = self.jacobians(X, u)
                return self.f(X, u), f_X + f_U @ self.kappa_jacobian(X)
        except (ArithmeticError, ValueError):  # floats raise where arrays give NaN
            return np.full(self.n, np.nan), np.full((self.n, self.n), np.nan)

    @cached_property
    def rests(self) -> bool:
        """True if the plant has an equilibrium to rest at: neither f nor kappa depends on time."""
        return self.autonomous and not self._timed("kappa")

    @cached_property
    def autonomous(self) -> bool:
        """True if f is free of time, so that the predictor is a function of (X, u, D_hat)."""
        return not self._timed("f")

    @cached_property
    def clocked(self) -> bool:
        """True if P depends on the time: f does, or kappa_j of an input that is predicted past its delay."""
        trace = Trace(self)
        x, _, t = trace.symbols()
        delay = [trace.delay(x, t)] if self.declares_delay else []
        laws = [] if self.one_delay else [*trace.kappa(x, t)[self.ratios < 1]]  # a plant without a law is predicted too
        return not self.autonomous or programs.depends([*laws, *delay], [t])

    @cached_property
    def phased(self) -> bool:
        """True if a network sees the phase of the time: P depends on it, by more than a delay D(t) that tells the time.

        Such a delay of time alone is an argument of P already; a plant that declares a period has its phase seen too.
        """
        if not (self.clocked and self.declares_delay and self.autonomous and self.period is None):
            return self.clocked
        trace = Trace(self)
        x, _, t = trace.symbols()
        return programs.depends([trace.delay(x, t)], [*x])

    def phase(self, t: Value) -> np.ndarray | None:
        """t / period modulo 1, (...): the time as a network sees it. None where it sees none.

        Raises ConfigError for a prediction that depends on time without a period.
        """
        if not self.phased:
            return None
        if self.period is None:
            why = "its prediction depends on time and a network sees X, u, D_hat and a phase"
            cure = "declare period, the time after which they repeat, or simulate it"
            raise ConfigError(f"plant {self.name}: expected a period, for {why}; {cure}")
        return np.asarray(t, dtype=float) / self.period % 1

    @cached_property
    def rest(self) -> tuple[np.ndarray, np.ndarray] | None:
        """(X*, u*), (n,) and (m,), that does not move: the equilibrium, or a reference with its input free of time."""
        if self.rests:
            return self.equilibrium, self.u_equilibrium
        trace = Trace(self)
        t = trace.input("t")
        if not self.autonomous or not self.tracks or programs.depends(trace.reference(t), [t]):
            return None
        X = self.target(0.0)
        moves = programs.depends(trace.kappa(np.array(X.tolist(), dtype=object), t), [t])
        return None if moves else (X, self.u_target(0.0))

    @cached_property
    def tracks(self) -> bool:
        """True if the plant declares a reference. Raises ConfigError where f and kappa know no time to follow it."""
        has_reference = getattr(self.declaration, "reference", None) is not None
        if has_reference and self.rests:
            got = "got one that rests; let it follow that, or drop reference"
            raise ConfigError(f"{self.location('reference')} expected a kappa that depends on t, {got}")
        return has_reference

    def _timed(self, name: str) -> bool:
        trace = Trace(self)
        x, u, t = trace.symbols()
        return programs.depends(trace.f(x, u, t) if name == "f" else trace.kappa(x, t), [t])

    @cached_property
    def program(self) -> Mapping[str, str]:
        """The text of each function, as its trace prints it: equal formulas have equal texts."""
        functions = ["f", *(["kappa"] if self.declares_kappa else []), "V"]
        functions += ["delay"] if self.declares_delay else []
        functions += ["reference"] if self.tracks else []
        functions += ["setpoint"] if self.declares_setpoint else []
        return {name: self.printed(name) for name in functions}

    @cached_property
    def formulas(self) -> Mapping[str, Any]:
        """What moves its state, numbers aside: the names of states and inputs, f, and how late each input is."""
        functions = ("f", "delay") if self.declares_delay else ("f",)
        texts = {name: self.printed(name) for name in functions} if self.traced else self.program
        of = {"states": self.states, "inputs": self.inputs, "ratios": self.ratios.tolist()}
        return of | {name: _digest(text) for name, text in texts.items()}

    @cached_property
    def identity(self) -> Mapping[str, Any]:
        """What a part made for it depends on: a plant that is made again by an equal declaration has an equal one."""
        parts = {"parameters": dict(self.parameters), "state_bounds": self.state_bounds, "outputs": self.outputs}
        parts |= {"box": self.box, "guess": self.guess.tolist(), "input_bounds": self.input_bounds}
        declared = {"output": self.declares_output, "safe": self.declares_safe}
        parts |= {name: _digest(self.printed(name)) for name, has in declared.items() if has and self.traced}
        return {**self.formulas, **parts, **{name: _digest(text) for name, text in self.program.items()}}

    def own(self, name: str, part: Any) -> None:
        """Raise ConfigError for a part, or a method of one, that was made for another plant, which it has as `plant`.

        One that `drifts`, as a network, and a law, which has the plant's formulas as `made_for`, may be of another
        plant's parameters. All others take those of the loop, and so must be made for them.
        """
        part = getattr(part, "__self__", part)
        of, whole, whose = getattr(part, "plant", None), not getattr(part, "drifts", False), "another plant"
        if of is self:
            return
        if isinstance(of, Plant):
            theirs, whose = of.identity if whole else of.formulas, of.name
        else:
            theirs, whole = getattr(part, "made_for", {}), False
        ours = self.identity if theirs and whole else self.formulas if theirs else {}
        if differ := [key for key in {**ours, **theirs} if ours.get(key) != theirs.get(key)]:
            got = f"got one of {whose}, whose {', '.join(differ)} differ"
            raise ConfigError(f"{name}: expected one of plant {self.name}, {got}; make it for this plant")

    def printed(self, name: str) -> str:
        """The lines of a function's program, from x0, …, u0, …, t and p0, … to y0, …; equal formulas, equal lines."""
        trace = Trace(self)
        x, u, t = trace.symbols()
        if name == "mechanics":
            at = trace.mechanics(x, u, t)
            outputs = [a for row in at.inertia for a in row] + at.force + at.damping
        else:
            inputs = {"f": (x, u, t), "reference": (t,)}.get(name, (x, t))
            outputs = [*np.ravel(np.array(getattr(trace, name)(*inputs), dtype=object))]
        return "\n".join(programs.lines(outputs, {}, names("y", len(outputs))))


def require(plant: object) -> None:
    """Raise ConfigError unless it is a plant."""
    if not isinstance(plant, Plant):
        raise ConfigError(f"plant: expected a Plant, got {plant!r}; make one with npred.plant")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _few(words: Sequence[str]) -> str:
    return ", ".join(words) if len(words) < 6 else f"{words[0]} … {words[-1]} ({len(words)})"
