"""A whole controller as C99: the kernels of its control step, a state, and its test."""

import hashlib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

import npred
from npred.delays import family_of
from npred.errors import ConfigError
from npred.kernels.c_text import comment, constant, fill, literal, single
from npred.kernels.kernel import Kernel, skeleton
from npred.loop import signals
from npred.loop.controller import Controller
from npred.predictors.guarded import bare
from npred.runtimes import c_controller_text as texts
from npred.runtimes.fused import Fused
from npred.symbolic import source_lines

NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")
PRECISIONS = {"float": np.float32, "double": np.float64}
SAVED = {"D_hat", "phi_before", "held", "total", "observer", "expected", "missed"}  # what a step remembers
DIGEST = "0" * 64
WHAT = "export controller"
SETTINGS = {"p": "p", "gamma_dt": "gamma_dt", "guard_settings": "guard"}  # by their names in C
FLAGS = ("recalls", "keeps", "gated")


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
    low, high = controller.settings.bounds.tolist()
    return low, min(high, controller.reach + controller.dt) if controller.settings.recalls else high


def digest(header: str) -> str:
    """The sha256 that a header holds, of both files."""
    return re.findall(r'_DIGEST "([0-9a-f]{64})"', header)[0]


def _check(controller: Controller) -> None:
    """Raise ConfigError for a part that is no kernel."""
    family_of(controller.plant).needs(WHAT)
    if not controller.predictor.compiled:
        raise ConfigError(
            f"{WHAT}: expected a predictor that is compiled, got {controller.predictor.name}; take a numerical one, or "
            'load the network with runtime = "fused"'
        )
    if controller.parts["update"] and not isinstance(controller.parts["update"], Kernel):
        law = type(controller.adaptation).__name__
        raise ConfigError(f"{WHAT}: expected a delay law that is compiled, {law} runs in Python; take another")


class _Writer:
    """The files of one controller: the kernels that run here, with one lane and the shapes written in."""

    def __init__(self, controller: Controller, name: str, precision: str, settings: Sequence[str] = ()) -> None:
        self.controller, self.name, self.real = controller, name, precision
        self.plant, self.parts = controller.plant, controller.parts | {"predict": _predict(controller, precision)}
        self.keeps, self.recalls = controller.keeps_commands, bool(controller.settings.recalls)
        self.watches, self.gated = self.parts["observe"] is not None, bool(controller.settings.gated)
        numbers = {name: np.atleast_1d(getattr(controller.settings, part)) for name, part in SETTINGS.items()}
        self.settings = {name: numbers[name].astype(float) for name in settings if numbers[name].size}

    def texts(self, model: str, test: Any) -> tuple[str, str]:
        """The header and the source, the digest of both inside."""
        slots = self._slots(model)
        slots["test"] = self._test(test) if test is not None else []
        plain = {name: slots.pop(name) for name in ("about", "kernels")}
        named = {name: [self._named(line) for line in lines] for name, lines in slots.items()}
        files = [fill(self._named(text), **named, **plain) for text in (texts.HEADER, texts.SOURCE)]
        digest = hashlib.sha256("".join(files).encode()).hexdigest()
        words = ", ".join(f"0x{digest[i : i + 8]}u" for i in range(0, 32, 8))
        header, source = (text.replace(DIGEST, digest).replace("DIGEST_WORDS", words) for text in files)
        return header, source

    def _named(self, text: str) -> str:
        """The text with the prefix of its identifiers."""
        return text.replace("@", self.name).replace("%%", self.name.upper()).replace("REAL", self.real)

    def _slots(self, model: str) -> dict[str, list[str]]:
        """The lines of the templates' slots."""
        arrays = self._arrays()
        return {
            "about": self._about(model),
            "sizes": [f"    %%_{name} = {value}," for name, value in self._sizes().items()],
            "saved": [f"    REAL {name}[{size}];" for name, size in arrays.items() if name in SAVED],
            "scratch": self._scratch(arrays),
            "kernels": self._kernels().splitlines(),
            "bodies": self._bodies(arrays),
            "functions": self._functions(),
            "signatures": texts.signatures(self.recalls, self.keeps),
        }

    def _sizes(self) -> dict[str, int]:
        z = self.controller.memory
        optional = {"ROWS": len(z.held)} if self.keeps else {}
        optional |= {"OBSERVER": len(z.observer)} if self.watches else {}
        sizes = {"N_STATES": self.plant.n, "M_INPUTS": self.plant.m, "NX": self.controller.predictor.nx}
        return sizes | optional

    def _arrays(self) -> dict[str, int]:
        """The arrays of the state by their sizes: those that a step uses."""
        used = {"D_hat", "phi_before", "Y", "U", "P"}
        used |= {"held", "total", "U0", "U1", "share", "D_seen"} if self.keeps else set()
        used |= {"u", "u_nodes"} if self.recalls else set()
        used |= {"X_hat", "expected", "missed"} if self.gated else set()
        used |= {"observer"} if self.watches else set()
        used |= {"phi", "N"} if self.parts["update"] else set()
        used |= {"error", "fallback"} if self.parts["guard"] else set()
        used |= {"D_seen"} if self.parts["believe"] else set()
        return {name: a.size for name, a in self.controller.memory._asdict().items() if name in used}

    def _scratch(self, arrays: dict[str, int]) -> list[str]:
        lines = [f"    REAL {name}[{size}];" for name, size in arrays.items() if name not in SAVED]
        members = [f"REAL {part}[{len(values)}];" for part, values in self.settings.items()]
        lines += [f"    struct {{ {' '.join(members)} }} settings; /* set by @_init */"] if members else []
        lines += [f"    REAL before[{arrays['observer']}];"] if self.watches else []
        return [*lines, f"    REAL work[{self._work()}];"]

    def _work(self) -> int:
        nx, guard = self.controller.predictor.nx, self.controller.settings.guard
        return max(1, *(part.work(nx, 1, guard) for part in self.parts.values() if part))

    def _kernels(self) -> str:
        """The kernels and the step, as the loop runs them here, and what they are set to."""
        types, structs = signals.declared()
        kernels = [text for part in self.parts.values() if part for text in part.texts]
        loop = [types, structs, skeleton("actuator.h"), skeleton("step.h"), skeleton("controller.h")]
        text = "\n".join(
            dict.fromkeys(["#define WIDE 1", "#define LANES", "#define INDEX int", skeleton("base.h"), *kernels, *loop])
        )
        values_of = self._numbers().items()
        numbers = [constant(f"the_{name}", values, self.real) for name, values in values_of if values.size]
        return "\n".join([single(text) if self.real == "float" else text, *numbers])

    def _numbers(self) -> dict[str, np.ndarray]:
        """The arrays of the settings."""
        numbers = {s.name: getattr(self.controller.settings, s.name) for s in signals.SETTINGS if s.axes is not None}
        return {name: np.ravel(a).astype(float) for name, a in numbers.items() if name not in ("delays", "samples")}

    def _bodies(self, arrays: dict[str, int]) -> list[str]:
        """The functions that bind the state, the settings and the kernels together, and call the step."""
        names = {name: f"self->{'saved.' if name in SAVED else ''}{name}" for name in arrays}
        if not self.gated:
            names["X_hat"] = names["Y"]
        if not self.recalls:
            names |= {"u": "(REAL *)u", "u_nodes": "(REAL *)u_nodes"}
        settings = self.controller.settings
        held = {name: f"(REAL *)the_{name}" for name, values in self._numbers().items() if values.size}
        held |= {name: str(int(getattr(settings, name))) for name in FLAGS}
        held |= {name: literal(getattr(settings, name), self.real) for name in ("dt", "b", "gate", "gamma_dt")}
        tunable = {part: f"self->settings.{name}" for name, part in SETTINGS.items() if name in self.settings}
        held |= {part: f"{text}[0]" if part == "gamma_dt" else text for part, text in tunable.items()}
        parts = {name: part.name for name, part in self.parts.items() if part}
        rows = "%%_ROWS" if self.keeps else "0"
        slots = {
            "state": [f".{name} = {text}," for name, text in names.items()],
            "settings": [f".{name} = {text}," for name, text in held.items()],
            "parts": [f".{name} = {text}," for name, text in parts.items()],
        }
        text = texts.BODIES + (texts.BOOKING if self.keeps else "")
        return fill(self._measuring(text).replace("<ROWS>", rows), **slots).splitlines()

    def _measuring(self, text: str) -> str:
        """The text with the actuator's state among the arguments, where it is measured."""
        words = {"MEASURED": ", const REAL *u, const REAL *u_nodes", "PASSED": ", u, u_nodes", "NONE": ", NULL, NULL"}
        for slot, arguments in words.items():
            text = text.replace(f"<{slot}>", "" if self.recalls else arguments)
        return text

    def _functions(self) -> list[str]:
        """Initialisation, the step, and what reads and sets the state."""
        slots = {
            "start": self._start(),
            "checks": texts.finite("X", "%%_N_STATES") + ([] if self.recalls else texts.MEASURED.splitlines()),
            "before": texts.BEFORE.splitlines() if self.watches else [],
            "after": texts.AFTER.splitlines() if self.watches else [],
            "keep": ["self->saved.k = @_remember(self, t);"] if self.keeps else [],
            "hold": ["@_hold(self, t);"] if self.keeps else [],
            "time": [self._time()],
            "unknown": [*texts.UNKNOWN.splitlines(), "self->saved.missed[0] = 0;"] if self.gated else [],
            "reach": self._too_long(),
            "check_commands": self._command_checks(),
        }
        low, high = D_hat_bounds(self.controller)
        names = {
            "LOW": low,
            "HIGH": high if np.isfinite(high) else float(np.finfo(PRECISIONS[self.real]).max),
            "DT": self.controller.dt,
        }
        text = fill(texts.FUNCTIONS, **slots)
        for name, value in names.items():
            text = text.replace(f"<{name}>", repr(float(value)))
        text = self._measuring(text)
        entry = texts.RECALLING if self.recalls else texts.MEASURING
        return (text + (texts.APPLIED if self.keeps else "") + entry).splitlines()

    def _time(self) -> str:
        """The time that the kernels see: of a law that repeats, within its period where a float would lose it."""
        clock = "self->saved.t0 + (double)self->saved.steps * <DT>".replace("<DT>", repr(self.controller.dt))
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
        lines += texts.OBSERVER.splitlines() if self.watches else []
        lines += texts.UNKNOWN.splitlines() if self.gated else []
        for part, values in self.settings.items():
            place, kept = f"self->settings.{part}", f"the_{SETTINGS[part]}"
            one = f"{place}[0] = {literal(values[0], self.real)};"
            lines.append(one if part == "gamma_dt" else f"memcpy({place}, {kept}, sizeof {place});")
        return sorted(lines, key=lambda line: not line.startswith("static"))

    def _too_long(self) -> list[str]:
        """The check of a delay that the plant declares."""
        if self.parts["believe"] is None or not self.recalls:
            return []
        return texts.TOO_LONG.replace("<REACH>", repr(self.controller.reach + self.controller.dt)).splitlines()

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
            f"A control step each {self.plant.time_text(self.controller.dt, '')}; D_hat and t are in this unit too.",
            f"In {self.real} precision; {source_lines.ranges(plant.inputs, controller.settings.input_bounds)}.",
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
        return fill(text, vector="\n".join(lines).splitlines()).splitlines()


def _predict(controller: Controller, precision: str) -> Any:
    """The kernel of the prediction; that of a network in the precision of the file."""
    model: Any = bare(controller.predictor)
    if precision == "float" and hasattr(model, "operator"):
        return Fused(model.plant, model.operator, model.nx, model.name, getattr(model, "stride", None)).on(model.nx)
    return controller.parts["predict"]


def _with_unit(plant: Any, name: str) -> str:
    unit = (plant.units or {}).get(name, "")
    return f"{name} ({unit})" if unit else name
