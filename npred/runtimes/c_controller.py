"""A whole controller as C99: every kernel of its control step translated, a state, and its test."""

import hashlib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

import npred
from npred.delays import family_of
from npred.errors import ConfigError
from npred.loop import control_step
from npred.loop.control_step import Memory
from npred.loop.controller import Controller
from npred.runtimes import c_controller_text as texts
from npred.symbolic import kernels, source_lines
from npred.symbolic.c99 import Array, Const, Fields, Foreign, Term, Unit, comment, constant
from npred.symbolic.c99.body import Translation

NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")
PRECISIONS = {"float": np.float32, "double": np.float64}
SAVED = {"D_hat", "phi_before", "held", "total", "observer", "X_hat", "missed"}  # what a step remembers
DIGEST = "0" * 64
WHAT = "export controller"
SETTINGS = ("p", "gamma_dt", "guard_settings")  # of npred.loop.control_step.Parts


def sources(
    controller: Controller, name: str = "npred", precision: str = "double", model: str = "", test: Any = None,
    settings: Sequence[str] = (),
) -> tuple[str, str]:  # fmt: skip
    """The header and the source. `test` are X (S, n) and, for measured actuators, u (S, nx, m) of steps to test with.

    `settings`, of SETTINGS, are numbers of the controller that its C struct holds, so that they can be set; of a
    guard's, the first, its threshold. All identifiers begin with `name`.
    Raises ConfigError for a name or precision that is none, and for a controller with a part that runs in Python.
    """
    if not NAME.fullmatch(name):
        raise ConfigError(f"--name: expected a short C identifier in lower case, got {name!r}; take npred")
    if precision not in PRECISIONS:
        raise ConfigError(f"--precision: expected float or double, got {precision!r}; name one of them")
    _check(controller)
    return _Writer(controller, name, precision, settings).texts(model, test)


def D_hat_bounds(controller: Controller) -> tuple[float, float]:
    """The smallest and the largest D_hat that the controller in C takes, in seconds; infinity for no limit."""
    low, high = controller.parts.bounds.tolist()
    return low, min(high, controller.reach + controller.dt) if controller.parts.recalls else high


def digest(header: str) -> str:
    """The sha256 that a header holds, of both files."""
    return re.findall(r'_DIGEST "([0-9a-f]{64})"', header)[0]


def _check(controller: Controller) -> None:
    """Raise ConfigError for a part without a kernel that can be translated."""
    family_of(controller.plant).needs(WHAT)
    if not controller.predictor.compiled:
        raise ConfigError(
            f"{WHAT}: expected a predictor that is compiled, got {controller.predictor.name}; take a numerical one, or "
            'load the network with runtime = "fused"'
        )
    if not hasattr(controller.parts.update, "py_func"):
        law = type(controller.adaptation).__name__
        raise ConfigError(f"{WHAT}: expected a delay law that is compiled, {law} runs in Python; take another")


class _Writer:
    """The files of one controller."""

    def __init__(self, controller: Controller, name: str, precision: str, settings: Sequence[str] = ()) -> None:
        self.controller, self.name, self.real = controller, name, precision
        self.plant, self.parts = controller.plant, controller.parts
        self.keeps = controller.keeps_commands
        self.unit = Unit(name, precision)
        self.unit.reserved.add("self")
        numbers = {part: np.atleast_1d(getattr(self.parts, part)).astype(float) for part in settings}
        self.settings = {part: values for part, values in numbers.items() if values.size}
        for part, values in self.settings.items():
            self.unit.use(self.unit.constant(values, part))
        self.used: dict[str, tuple[int, ...]] = {}  # the arrays of the state, in the order of Memory
        self.advance = self._body("calculate", control_step.control_step)
        booking = (control_step.remember, control_step.hold) if self.keeps else ()
        self.bodies = [self.advance, *(self._body(function.__name__, function) for function in booking)]
        for body in self.bodies:
            if body.members or body.callees:
                self.unit.structs.append(self.unit.struct(f"{name}_{body.where}", body))

    def _body(self, where: str, function: Any) -> Translation:
        """A function of npred.loop.control_step, with the controller's parts and the arrays of its state in C."""
        definition, space = kernels.definition(function)
        arguments = {
            "s": Fields({name: self._part(name, value) for name, value in self.parts._asdict().items()}),
            "z": Fields({name: self._array(name, getattr(self.controller.memory, name)) for name in Memory._fields}),
            "k": Term("self->saved.k", "int", low=0),
            "t": Term("t", self.real),
            "dt": Const(self.parts.dt, self.real),
            "P": Array.whole("self->P", self.real, (self.controller.predictor.nx, self.plant.n, 1)),
        }
        body = Translation(self.unit, where, space, {a.arg: arguments[a.arg] for a in definition.args.args})
        body.translate(definition.body)
        return body

    def _part(self, name: str, value: Any) -> Any:
        if name in self.settings:
            fixed = np.array([np.nan, *self.settings[name][1:]]) if name == "guard_settings" else None
            held = Array.whole(f"self->settings.{name}", self.real, self.settings[name].shape, fixed=fixed)
            return held if isinstance(value, np.ndarray) else Term(f"{held.name}[0]", self.real)
        if isinstance(value, np.ndarray):
            return self.unit.constant(value, name)
        kinds = {bool: "bool", float: self.real}
        return Const(value, kinds[type(value)]) if type(value) in kinds else Foreign(value)

    def _array(self, name: str, value: np.ndarray) -> Array:
        measured = ("X", "u", "u_nodes") if not self.parts.recalls else ("X",) if not self._gated else ()
        owner = "" if name in measured else "self->saved." if name in SAVED else "self->"
        return Array.whole(owner + name, self.real, value.shape)

    def texts(self, model: str, test: Any) -> tuple[str, str]:
        """The header and the source, the digest of both inside."""
        slots = self._slots(model)
        slots["test"] = self._test(test) if test is not None else []
        plain = {name: slots.pop(name) for name in ("about", "declarations", "memories")}
        named = {name: [self._named(line) for line in lines] for name, lines in slots.items()}
        files = [kernels.fill(self._named(text), **named, **plain) for text in (texts.HEADER, texts.SOURCE)]
        digest = hashlib.sha256("".join(files).encode()).hexdigest()
        words = ", ".join(f"0x{digest[i : i + 8]}u" for i in range(0, 32, 8))
        header, source = (text.replace(DIGEST, digest).replace("DIGEST_WORDS", words) for text in files)
        return header, source

    def _named(self, text: str) -> str:
        """The text with the prefix of its identifiers."""
        return text.replace("@", self.name).replace("%%", self.name.upper()).replace("REAL", self.real)

    def _slots(self, model: str) -> dict[str, list[str]]:
        """The lines of the templates' slots."""
        declarations = self.unit.declarations()
        arrays = self._arrays(declarations)
        return {
            "about": self._about(model),
            "sizes": [f"    %%_{name} = {value}," for name, value in self._sizes().items()],
            "memories": "\n\n".join(self.unit.structs).splitlines(),
            "saved": [f"    REAL {name}[{size}];" for name, size in arrays.items() if name in SAVED],
            "scratch": self._scratch(arrays),
            "declarations": declarations.splitlines(),
            "bodies": [line for body in self.bodies for line in self._function(body)],
            "functions": self._functions(),
            "signatures": texts.signatures(self.parts.recalls, self.keeps),
        }

    def _sizes(self) -> dict[str, int]:
        z = self.controller.memory
        optional = {"ROWS": len(z.held)} if self.keeps else {}
        optional |= {"OBSERVER": len(z.observer)} if self._watches else {}
        sizes = {"N_STATES": self.plant.n, "M_INPUTS": self.plant.m, "NX": self.controller.predictor.nx}
        return sizes | optional

    @property
    def _watches(self) -> bool:
        return self.parts.observe is not None

    @property
    def _gated(self) -> bool:
        return self.parts.model is not None

    def _arrays(self, declarations: str) -> dict[str, int]:
        """The arrays of the state by their sizes: those that a step uses."""
        text = "\n".join([declarations, *(line for body in self.bodies for line in body.lines)])
        sizes = {name: getattr(self.controller.memory, name).size for name in Memory._fields}
        named = set(re.findall(r"self->(?:saved\.)?(\w+)", text)) | {"D_hat", "phi_before", "U"}
        return {name: size for name, size in sizes.items() if name in named}

    def _scratch(self, arrays: dict[str, int]) -> list[str]:
        lines = [f"    REAL {name}[{size}];" for name, size in arrays.items() if name not in SAVED]
        lines += [f"    REAL P[{self.controller.predictor.nx * self.plant.n}];"]
        members = [f"REAL {part}[{len(values)}];" for part, values in self.settings.items()]
        lines += [f"    struct {{ {' '.join(members)} }} settings; /* set by @_init */"] if members else []
        lines += [f"    REAL before[{arrays['observer']}];"] if self._watches else []
        for body in self.bodies:
            if body.members or body.callees:
                lines.append(f"    struct @_{body.where}_memory {body.where};")
        return lines

    def _function(self, body: Translation) -> list[str]:
        """The C function of one of the bodies."""
        name, advances = body.where, body is self.advance
        measured = "" if self._gated else "const REAL *X, " if self.parts.recalls else texts.ARRAYS
        arguments = f"{measured if advances else ''}REAL t"
        head = f"static {'int' if name == 'remember' else 'void'} @_{name}(@_controller *self, {arguments})"
        memory = f"    struct @_{name}_memory *memory = &self->{name};"
        named = "\n".join(body.lines)
        unused = [
            f"    (void){c};" for c in re.findall(r"(\w+)(?:,|$)", arguments) if not re.search(rf"\b{c}\b", named)
        ]
        top = [memory] if body.members or body.callees else []
        return [head, "{", *unused, *top, *(f"    {line}" for line in body.top), *body.lines, "}", ""]

    def _functions(self) -> list[str]:
        """Initialisation, the step, and what reads and sets the state."""
        slots = {
            "start": self._start(),
            "checks": texts.finite("X", "%%_N_STATES") + ([] if self.parts.recalls else texts.MEASURED.splitlines()),
            "before": texts.BEFORE.splitlines() if self._watches else [],
            "after": texts.AFTER.splitlines() if self._watches else [],
            "keep": ["self->saved.k = @_remember(self, t);"] if self.keeps else [],
            "hold": ["@_hold(self, t);"] if self.keeps else [],
            "take": ["memcpy(self->X, X, sizeof self->X);"] if self._gated else [],
            "time": [self._time()],
            "unknown": [*texts.UNKNOWN.splitlines(), "self->saved.missed[0] = 0;"] if self._gated else [],
            "reach": self._too_long(),
            "check_commands": self._command_checks(),
        }
        low, high = D_hat_bounds(self.controller)
        names = {
            "LOW": low,
            "HIGH": high if np.isfinite(high) else float(np.finfo(PRECISIONS[self.real]).max),
            "DT": self.parts.dt,
        }
        text = kernels.fill(texts.FUNCTIONS, **slots)
        for name, value in names.items():
            text = text.replace(f"<{name}>", repr(float(value)))
        arguments = ("", "X, ") if self.parts.recalls else (", const REAL *u, const REAL *u_nodes", "X, u, u_nodes, ")
        passed = "" if self._gated else arguments[1]
        text = text.replace("<MEASURED>", arguments[0]).replace("<PASSED>", passed)
        entry = texts.RECALLING if self.parts.recalls else texts.MEASURING
        return (text + (texts.APPLIED if self.keeps else "") + entry).splitlines()

    def _time(self) -> str:
        """The time that the kernels see: of a law that repeats, within its period where a float would lose it."""
        clock = "self->saved.t0 + (double)self->saved.steps * <DT>".replace("<DT>", repr(self.parts.dt))
        if self.real == "float" and self.plant.period:
            clock = f"fmod({clock}, {self.plant.period!r})"
        return f"const REAL t = (REAL)({clock});"

    def _start(self) -> list[str]:
        """The first state."""
        controller = self.controller
        lines = [f"self->saved.D_hat[0] = (REAL){controller.D_hat!r};", f"self->saved.t0 = {controller.t!r};"]
        if self.keeps:
            u0 = ", ".join(f"(REAL){value!r}" for value in controller.u0.tolist())
            origin = len(controller.memory.held) - 1
            lines += [f"static const REAL u0[] = {{{u0}}};", f"self->saved.k = {origin};"]
            lines += texts.COMMANDS.replace("<ORIGIN>", str(origin)).splitlines()
        lines += texts.OBSERVER.splitlines() if self._watches else []
        lines += texts.UNKNOWN.splitlines() if self._gated else []
        for part, values in self.settings.items():
            place = f"self->settings.{part}"
            lines.append(f"memcpy({place}, {self.unit.constant(values, part).name}, sizeof {place});")
        declared = [line for line in lines if line.startswith("static")]
        return [*declared, *(line for line in lines if not line.startswith("static"))]

    def _too_long(self) -> list[str]:
        """The check of a delay that the plant declares."""
        if self.parts.believe is None or not self.parts.recalls:
            return []
        return texts.TOO_LONG.replace("<REACH>", repr(self.controller.reach + self.parts.dt)).splitlines()

    def _command_checks(self) -> list[str]:
        if not self.keeps:
            return []
        rows = len(self.controller.memory.held)
        lines = [f"fits = fits && state->k >= {rows - 1} && state->k < {2 * rows};"]
        return lines + texts.FINITE_COMMANDS.splitlines()

    def _about(self, model: str) -> list[str]:
        plant, controller = self.plant, self.controller
        law = "frozen" if controller.adaptation is None else f"by {type(controller.adaptation).__name__}"
        names = [
            (kind, ", ".join(_with_unit(plant, name) for name in names))
            for kind, names in (("X", plant.states), ("U", plant.inputs))
        ]
        lines = [
            f"The controller of plant {plant.name}, made by npred {npred.__version__}.",
            *([f"Model: {model}."] if model else []),
            f"Predictor {controller.predictor.name} on {controller.predictor.nx} nodes; D_hat {law}.",
            f"A control step each {self.plant.time_text(self.parts.dt, '')}; D_hat and t are in this unit too.",
            f"In {self.real} precision; {source_lines.ranges(self.plant.inputs, self.parts.input_bounds)}.",
            *(f"{kind}: {text}." for kind, text in names),
        ]
        return [f" * {comment(line)}" for line in lines]

    def _test(self, test: Any) -> list[str]:
        """The program that compares steps with those of the controller in Python."""
        controller = self.controller.fresh()
        X, u = test
        rows = [(controller.step(x, None if u is None else u[i]).copy(), controller.D_hat) for i, x in enumerate(X)]
        U, D_hat = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
        arrays = {"X": X} | ({} if u is None else {"u": u}) | {"U": U, "D_hat": D_hat}
        arrays["size"] = np.where((size := np.abs(U).max(axis=0)) > 0, size, 1.0)
        lines = [constant(f"test_{name}", np.ravel(a), self.real) for name, a in arrays.items()]
        passed = "" if u is None else "test_u + s * %%_NX * %%_M_INPUTS, "
        text = texts.TEST.replace("<U>", passed).replace("<STEPS>", str(len(X)))
        text = text.replace("<LIMIT>", {"float": "1e-3", "double": "1e-9"}[self.real])
        return kernels.fill(text, vector="\n".join(lines).splitlines()).splitlines()


def _with_unit(plant: Any, name: str) -> str:
    unit = (plant.units or {}).get(name, "")
    return f"{name} ({unit})" if unit else name
