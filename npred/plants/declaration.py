"""The declaration of a plant as a frozen model: a part that is wrong is one line, before anything is traced."""

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from keyword import iskeyword
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, ValidationError, WrapValidator, model_validator

from npred.base import array_checks
from npred.base.errors import ConfigError, similar, unlisted
from npred.plants import setpoint

NAME = re.compile(r"\w[\w., -]{0,99}")
LONGEST = 40  # letters of a label or a unit
CALLED = ("df", "dkappa", "files", "rests")  # further parts of a black box
_LIMITS, _LATE = "; did you mean input_bounds?", "; did you mean delays, or D of the loop?"
_LOOPS = "; it is the loop's: pass it to npred.simulate"
_JUMPS = "; states do not jump: did you mean state_bounds, or M.where in f?"
_RATES = "; declare the actuator as a state, u' = v, and its rate v as the input, with input_bounds"
ELSEWHERE = {  # where npred has what others declare by these names
    "bounds": "; did you mean input_bounds or box?", "limits": "; did you mean input_bounds or safe?",
    **dict.fromkeys(("u_max", "u_min", "umax", "umin", "u_bounds", "saturation", "input_limits"), _LIMITS),
    **dict.fromkeys(("rate_limit", "rate_limits", "slew_rate", "du_max"), _RATES),
    **dict.fromkeys(("event", "events", "reset", "resets", "jump", "jumps"), _JUMPS),
    **dict.fromkeys(("d", "tau", "dead_time", "lag", "input_delay", "time_delay"), _LATE),
    **dict.fromkeys(("disturbance", "sensors", "dt", "t_end", "x0", "u0", "d_hat"), _LOOPS),
    "params": "; did you mean parameters?",
    "equilibrium": "; did you mean guess?", "x_eq": "; did you mean guess?", "dynamics": "; did you mean f?",
    **dict.fromkeys(("controller", "control", "law"), "; did you mean kappa?"), "lyapunov": "; did you mean V?",
}  # fmt: skip
MARKUP = set("$\\")  # matplotlib would read these as mathematics


def expected(
    words: str, cure: str | Callable[[Any], str], condition: Callable[[Any], bool] = lambda value: True
) -> WrapValidator:
    """One sentence for a value that is not of the type, or does not meet the condition; its items have others."""

    def check(value: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            checked = handler(value)
            if condition(checked):
                return checked
        except ValidationError as error:
            if error.errors()[0]["loc"]:  # an item's error
                raise
        raise ValueError(f"expected {words}, got {value!r}; {cure(value) if callable(cure) else cure}")

    return WrapValidator(check)


def _is_name(word: str) -> bool:
    return word.isidentifier() and not iskeyword(word) and not word.startswith("_")


def _names(value: Any) -> list[str]:
    """Different names in a text, in quotes; none where there are others."""
    names = re.findall(r"[^\s,;]+", value) if isinstance(value, str) else []
    return [f'"{name}"' for name in names] if all(map(_is_name, names)) and len(names) == len(set(names)) else []


def _number(value: Any) -> list[str]:
    """A finite number alone."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return [str(value)] if is_number else []


def _tupled(items_of: Callable[[Any], list[str]], otherwise: str) -> Callable[[Any], str]:
    """The cure of what is no tuple: of one item parentheses make none, the comma does. Without items, another."""

    def cure(value: Any) -> str:
        items = items_of(value)
        return f"write ({', '.join(items)}{',' * (len(items) == 1)}), with the comma" if items else otherwise

    return cure


def _listed(value: Any) -> Any:
    """The items of a list, a tuple, a table or an array; those of a set have no order."""
    if isinstance(value, str) or not isinstance(value, Sequence | Mapping | np.ndarray):
        raise ValueError
    return tuple(value)


def _pairs(value: Any) -> Any:
    """The items of a list of pairs; one pair alone, and a table, are not that."""
    if isinstance(value, Mapping) or not all(np.iterable(item) for item in _listed(value)):
        raise ValueError
    return _listed(value)


LIST, STRICT = BeforeValidator(_listed), Field(strict=True)
REAL = BeforeValidator(partial(array_checks.number, ""))  # float() would also take a text
DIFFERENT = expected(
    'different names, as ("h",)',
    _tupled(_names, "write each once, in quotes"),
    lambda names: 0 < len(names) == len(set(names)),
)
IN_ORDER = expected("a range (low, high) with low <= high", "write both", lambda ends: ends[0] <= ends[1])
IS_NAME = expected("a name that Python accepts", "rename it", _is_name)
IS_LINE = expected(
    f"up to {LONGEST} letters on one line, without $ and backslash",
    "shorten it",
    lambda words: words.isprintable() and len(words) <= LONGEST and not MARKUP & set(words),
)
Name = Annotated[str, STRICT, IS_NAME]
Names = Annotated[tuple[Name, ...], LIST, DIFFERENT]
Number = Annotated[float, REAL, expected("a number", "write one")]
Finite = Annotated[float, REAL, expected("a finite number", "write one", math.isfinite)]
Time = Annotated[Finite, expected("a time above 0", "write how long", lambda time: time > 0)]
Delay = Annotated[Finite, expected("a time, 0 or more", "write how long", lambda time: time >= 0)]
Values = Annotated[tuple[Finite, ...], LIST, expected("one number per state", _tupled(_number, "write numbers"))]
Delays = Annotated[tuple[Delay, ...], LIST, expected("the time of each input", _tupled(_number, "write numbers"))]
Range = Annotated[tuple[Number, Number], LIST, IN_ORDER]
Bounds = Annotated[
    tuple[Range, ...], BeforeValidator(_pairs), expected("a pair (low, high) per input", "write ((0.0, 1.0),), say")
]
Ranges = Annotated[dict[str, Range], expected('ranges as {"h": (0.0, 1.0)}', "write a dict")]
FiniteRange = Annotated[tuple[Finite, Finite], LIST, IN_ORDER]
Box = Annotated[dict[str, FiniteRange], expected('ranges as {"h": (0.0, 1.0)}', "write a dict")]
OneNumber = Annotated[
    float,
    REAL,
    expected(
        "a finite number", "write one; give each number of an array a name, or keep it outside the class", math.isfinite
    ),
]
Parameters = Annotated[dict[Name, OneNumber], expected('a table {"a": 1.0}', "write a dict")]
Text = Annotated[str, STRICT, AfterValidator(lambda text: text.strip()), IS_LINE]
Texts = Annotated[dict[str, Text], expected('texts as {"h": "m"}', "write a dict")]
Function = Annotated[Callable[..., Any], expected("a function", "write one with def")]


class Declaration(BaseModel, frozen=True):
    """The parts of a plant's class that are read when the plant is made, as docs/plant_declaration.md has them."""

    states: Names
    inputs: Names
    f: Function
    kappa: Function | None = None
    V: Function | None = None
    delay: Function | None = None
    mechanics: Function | None = None
    rollout: Function | None = None
    reference: Function | None = None
    output: Function | None = None
    observation: Function | None = None
    outputs: Names | None = None
    safe: Function | None = None
    setpoint: Function | None = None
    parameters: Parameters = {}
    box: Box = {}
    guess: Values | None = None
    input_bounds: Bounds | None = None
    state_bounds: Ranges = {}
    delays: Delays | None = None
    period: Time | None = None
    labels: Texts = {}
    units: Texts = {}
    time_unit: Text = "s"
    figure: Text = ""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        """As many values as there are states or inputs, and no other names than theirs."""
        for part, names in {"guess": self.states, "input_bounds": self.inputs, "delays": self.inputs}.items():
            values = getattr(self, part)
            if values is not None and len(values) != len(names):
                each = f"one for each of {', '.join(names)}"
                raise ValueError(f"{part}: expected {each}, got {values}; give {len(names)}")
        if self.delays and not any(self.delays):
            raise ValueError("delays: expected a delay above 0, got none; drop delays, and give the loop D = 0")
        if self.delay and {"u", "U"} & set(inspect.signature(self.delay).parameters):
            refused = f"a delay that depends on the input is not supported, got delay{inspect.signature(self.delay)}"
            raise ValueError(f"delay: {refused}; write delay(x, t, p, M)")
        if self.outputs and not self.output:
            cure = "write it, or drop outputs"
            raise ValueError(f"outputs: expected output(x, t, p, M), which gives them, got none; {cure}")
        if self.setpoint and self.reference:
            both = "expected one of them, got both; drop the one that kappa does not lead to"
            raise ValueError(f"setpoint, reference: {both}")
        for name in setpoint.of_rest(self.states, self.inputs) if self.setpoint else ():
            if name in self.parameters:
                raise ValueError(f"parameters: {name} is what setpoint gives, expected another name; rename it")
        quantities = (*self.states, *self.inputs, *(self.outputs or ()))
        allowed = {"box": self.states, "state_bounds": self.states, "labels": quantities, "units": quantities}
        for part, names in allowed.items():
            for name in getattr(self, part):
                if name not in names:
                    raise ValueError(unlisted(part, name, names))
        return self


def read(plant: str, declaration: Any, overrides: Mapping[str, Any]) -> Declaration:
    """The parts of the class, its parameters overridden. Raises ConfigError for missing, unknown or wrong parts.

    That is also a name of the plant that could be more than a name where it is written, in C say.
    """
    if not isinstance(plant, str) or not NAME.fullmatch(plant):
        letters = "a name of letters, digits, spaces and . , _ -"
        raise ConfigError(f"plant: expected {letters}, got {plant!r}; choose another")
    parts = {name: getattr(declaration, name) for name in Declaration.model_fields if hasattr(declaration, name)}
    defaults = parts.get("parameters", {})
    for key in overrides if isinstance(defaults, Mapping) else ():
        if key not in defaults:
            if near := similar(key, ["kappa"]):
                raise ConfigError(f"plant {plant}: expected parameters, got {key!r}{near}")
            raise ConfigError(unlisted(f"plant {plant}", key, defaults, "parameters"))
        parts["parameters"] = {**defaults, **overrides}
    parts_of_kind = (*Declaration.model_fields, "traced", *(CALLED if not getattr(declaration, "traced", True) else ()))
    for name in dir(declaration) if parts else ():
        if not name.startswith("_") and name not in parts_of_kind:
            meant = ELSEWHERE.get(name.casefold()) or similar(name, parts_of_kind)
            cure = "rename it, or begin it with an underscore, as what is no part does"
            raise ConfigError(f"plant {plant}: {name}: unknown part{meant}; {cure}")
    try:
        return Declaration.model_validate(parts)
    except ValidationError as error:
        first = error.errors()[0]
    part, *items = first["loc"] or ("",)
    if first["type"] == "missing":
        raise ConfigError(f"plant {plant}: expected states, inputs, f, found no {part}; declare it")
    where = "".join(f"[{item!r}]" for item in items if item != "[key]")
    sentence = f"{part}{where}: {first['msg'].removeprefix('Value error, ')}".removeprefix(": ")
    raise ConfigError(f"plant {plant}: {' '.join(sentence.split())}")


def completed(plant: str, declaration: Any, kappa: Function | None = None) -> Any:
    """The declaration with the law `kappa` where one is given, with V = 0 where it has none, and with a kappa that
    refuses to be called where it has none: such a plant can be looked at, and be offered them.
    """
    parts: dict[str, Any] = {} if kappa is None else {"kappa": kappa}
    if kappa is None and getattr(declaration, "kappa", None) is None:
        cure = 'declare it, or set kappa = "lqr" (--set kappa=lqr); npred plants check offers one'

        def absent(*_: Any) -> Any:
            raise ConfigError(f"plant {plant}: expected kappa(x, t, p, M), found none; {cure}")

        parts["kappa"] = absent
    if getattr(declaration, "V", None) is None:
        parts["V"] = lambda x, t, p, M=None: np.zeros(len(x)) if M is None else 0.0  # on rows, or on components
    functions = {name: staticmethod(function) for name, function in parts.items()}
    return type(declaration.__name__, (declaration,), functions) if functions else declaration
