"""The declared functions of a plant, which stands on a higher floor: their calls, and their failures with advice."""

import re
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any, ClassVar, NoReturn, Protocol

import numpy as np

from npred.base import source_lines
from npred.base.errors import ConfigError, first_line, installed, similar
from npred.formulas import Parameters, Value
from npred.formulas.tape import INSTEAD, NAMES, Functions

Components = list[Value] | None

SIGNATURES = {"f": "f(x, u, t, p, M)", "mechanics": "mechanics(x, u, t, p, M)", "reference": "reference(t, p, M)"}
SIGNATURES["observation"] = "observation(x, u, t, p, M)"
SIGNATURES |= {name: f"{name}(x, t, p, M)" for name in ("kappa", "V", "delay", "output", "safe", "setpoint")}
ON_ROWS = {"f": "f(X, u, t, p)", "reference": "reference(t, p)", "df": "df(X, u, t, p, v)"}
ON_ROWS |= {"output": "output(X, t, p)", "kappa": "kappa(X, t, p)", "V": "V(X, t, p)", "dkappa": "dkappa(X, t, p, v)"}
ON_ROWS |= {"rollout": "rollout(X, u, D_hat, t, p)"}
DELAYED_STATE = "only inputs arrive late; for a state x.h at t - tau declare states that follow it, N of them: " + (
    "z1' = N (x.h - x.z1) / tau, z2' = N (x.z1 - x.z2) / tau, …"
)
LATE_ALREADY = "inputs arrive late by themselves: write {input} for U(t - D)"
LIBRARIES = {"np": "numpy", "jnp": "jax.numpy", "sp": "scipy"}  # by the names that they are given
UNTRACED = "write its formulas with M, or set traced = False, for functions of arrays that are called"
HINTS = {
    **dict.fromkeys(("for ^", "'bitwise_xor'"), "write ** for a power, as x.h**2"),
    **dict.fromkeys(("for &", "'bitwise_and'"), "write M.logical_and(a, b)"),
    **dict.fromkeys(("for |", "'bitwise_or'"), "write M.logical_or(a, b)"),
    "unary ~": "write M.logical_not(a)",
    "for //": "write M.floor(a / b)",
    "a decision on": "write M.where(condition, a, b)",
    "tuple indices must be": "states, inputs and parameters have names: write x.name, u.name, p.name",
    "'Symbol' object has no attribute": "look at the order of the arguments: write def {signature}",
    "Inputs": "inputs have names: write u.name",
    "State": "states have names: write x.name",
}
RETURNS = {
    "f": "one derivative per state",
    "kappa": "one value per input",
    "reference": "one value per state",
    "V": "one number, not a list",
    "delay": "one number of seconds, not a list",
    "mechanics": "M, force and damping",
    "output": "a list, one value per output",
    "setpoint": "a list, one value per input, 0 at rest",
    "safe": "a list, one value per limit, at least 0 where it is safe",
}


class Declared(Protocol):
    """A plant as the formula compiler needs it: names, sizes, parameters, functions; npred.plants.Plant has them."""

    traced: ClassVar[bool]
    name: str
    declaration: Any
    declares_kappa: bool
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    p_names: tuple[str, ...]

    @property
    def n(self) -> int: ...
    @property
    def m(self) -> int: ...
    @property
    def parameters(self) -> Mapping[str, float]: ...

    def call(self, name: str, x: Components, u: Components, t: Value, p: Sequence[Value], M: Functions) -> list[Value]:
        """A declared function on components of any kind."""
        ...

    def location(self, name: str) -> str:
        """A declared function in words, with file and line."""
        ...


def call(
    plant: Declared, name: str, x: Components, u: Components, t: Value, p: Sequence[Value], M: Functions
) -> list[Value]:
    """The declared function on named components; a failure inside it becomes one line with the line of the file.

    Only f and mechanics take u, and `reference` takes the time alone.
    """
    state = () if x is None else (record("State", plant.states)(*x),)
    named = record("Parameters", plant.p_names)(*p)
    inputs = () if u is None else (record("Inputs", plant.inputs)(*u),)
    function = getattr(plant.declaration, name)
    if name == "observation":
        inputs = (LastAction(plant),)
    if name == "kappa" and getattr(function, "observes", False) and hasattr(plant.declaration, "observation"):
        state = (call(plant, "observation", x, None, t, p, M),)
    try:
        values = function(*state, *inputs, t, named, M)
    except ConfigError:
        raise
    except Exception as error:
        raise failure(plant, name, error) from None
    if name in ("V", "delay"):
        return [values]
    # A formula that returns a bare number returns, on arrays, an array without an axis of components.
    several = isinstance(values, list | tuple) or np.ndim(values) > np.ndim(t if x is None else x[0])
    return list(values) if several else [values]


class LastAction:
    """The u of observation, which a law of the predicted state does not know: to read it is refused."""

    def __init__(self, plant: Declared) -> None:
        self.__plant = plant

    def __getattr__(self, name: str) -> NoReturn:
        what = f"{self.__plant.location('observation')} expected what the state tells, got the last action, u"
        late = self.__plant.inputs[0]
        cure = f"declare a state that follows u.{late}, say z' = (u.{late} - x.z) / tau, and observe that"
        raise ConfigError(f"{what}; {cure}")

    __getitem__ = __iter__ = __len__ = __getattr__


def parameters(plant: Declared) -> Parameters:
    """The parameters' values by name."""
    return record("Parameters", tuple(plant.parameters))(*np.array([*plant.parameters.values()], dtype=float))


def failure(plant: Declared, name: str, error: Exception) -> ConfigError:
    """A failure inside a declared function, in one line: where in the author's file, and the likely name."""
    function = getattr(plant.declaration, name)
    line = source_lines.where(error, function) or f" ({source_lines.line(function)})"
    message = f"plant {plant.name}: {name} failed{line}: {type(error).__name__}: {first_line(error)}"
    return ConfigError("; ".join(filter(None, (message, _cure(plant, name, error)))))


@cache
def record(kind: str, names: tuple[str, ...]) -> Callable[..., Parameters]:
    """The class of components with names, as declared functions take them: record("State", ("h",))(1.0).h."""
    return namedtuple(kind, names)


def _cure(plant: Declared, function: str, error: Exception) -> str:
    signature = (SIGNATURES if plant.traced else ON_ROWS)[function]
    if not source_lines.where(error, getattr(plant.declaration, function)):  # it was not even entered
        return f"write def {signature}"
    match error:
        case AttributeError(name=name, obj=record) if (names := getattr(record, "_fields", None)) is not None:
            return f"expected one of {', '.join(names) or 'none: none is declared'}{similar(str(name), names)}"
        case AttributeError(name=name, obj=SimpleNamespace() as of_M):
            near = f"; write {INSTEAD[name]}" if name in INSTEAD else similar(str(name), vars(of_M))
            return f"expected one of M's {', '.join(vars(of_M))}{near}"
        case NameError(name=name):
            return _meant(str(name), plant, function, signature, error)
        case TypeError() if "object is not callable" in str(error):
            return _of_call(error, plant, getattr(plant.declaration, function))
    if plant.traced and (cure := _of_M(error, getattr(plant.declaration, function))):
        return f"write {cure}"
    for words, hint in HINTS.items():
        if words in str(error):
            return hint.format(signature=signature)
    if plant.traced and (library := source_lines.library(error)):
        return f"{library} takes no state of a trace: {UNTRACED}"
    return "" if ";" in str(error) else f"fix {function}"


def _of_M(error: Exception, function: Callable[..., Any]) -> str | None:
    """What M has for the function of another library that a symbol was passed to."""
    home, _, called = source_lines.called(error, function).rpartition(".")
    ufunc = re.search(r"no callable (\w+) method", str(error))  # of NumPy, which asks a symbol for it
    names = [called] * (home != "M") + [ufunc[1] if ufunc else ""]
    return next((INSTEAD.get(name, f"M.{name}") for name in names if name in (*NAMES, *INSTEAD)), None)


def _of_call(error: Exception, plant: Declared, function: Callable[..., Any]) -> str:
    """The advice on a call of a quantity: of an input that is to be late, of a state that is, of one without its *."""
    name = source_lines.called(error, function)
    argument = source_lines.failed(error, function).removeprefix(name)
    home = re.split(r"[.[]", name)[0]
    if home == "u" or name in plant.inputs:
        return LATE_ALREADY.format(input="u.name" if name == "u" and plant.traced else name)
    if (home == "x" or name in plant.states) and re.match(r"\(\s*t\b", argument):
        return DELAYED_STATE
    return "write * for a product, as a * (b + c)"


def _meant(name: str, plant: Declared, function: str, signature: str, error: Exception) -> str:
    """The advice on a name that the function does not know."""
    of_library = re.match(r"\w+\.(?:\w+\.)*(\w+)", source_lines.failed(error, getattr(plant.declaration, function)))
    if of_library and plant.traced and of_library[1] in (*NAMES, *INSTEAD):
        return f"write {INSTEAD.get(of_library[1], f'M.{of_library[1]}')}"
    homes = {"p": plant.p_names} | ({"x": plant.states, "M": NAMES} if plant.traced else {})
    if function in ("f", "mechanics") and plant.traced:
        homes["u"] = plant.inputs
    for home, names in homes.items():
        if name in names:
            return f"write {home}.{name}"
    arguments = signature.partition("(")[2].rstrip(")")
    if name in ("u", *plant.inputs) and function not in ("f", "mechanics"):
        return f"only f knows the inputs, and kappa gives them: write {function} in {arguments}"
    near = similar(name, [f"{home}.{each}" for home, names in homes.items() for each in names])
    if of_library and installed(LIBRARIES.get(name, name)):
        long = LIBRARIES.get(name, "")
        near = f"; write import {long + ' as ' * bool(long)}{name} above the class"
    return f"expected one of {arguments}, or what the file defines{near}"
