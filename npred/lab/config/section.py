"""A table of the pipeline file, and the types of its keys."""

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import partial
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from npred.base import registry
from npred.base.registry import BASELINES, DELAY_LAWS, FROZEN, LAWS, METHODS, NETWORKS, OBSERVERS, RUNTIMES, Registry
from npred.loop.timing import LATENCIES

MOST = 2**53  # the largest count that a key takes
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
Delay = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Count = Annotated[int, Field(ge=1, le=MOST, strict=True)]
Nodes = Annotated[int, Field(ge=2, le=MOST, strict=True)]
Item = TypeVar("Item")
Some = Annotated[list[Item], Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Limit = Annotated[float, Field(strict=True)]  # also infinite
FILES = ("data", *LATENCIES)  # keys whose text is the name of a file
Switch = Annotated[bool, Field(strict=True)]
PerState = Number | list[Number]
Anchor = Literal["none", "initial", "equilibrium"]
TABLE = ("a table", "write keys and values")
EXPECTED = {  # what pydantic misses, by its name of the error, and what to do; in braces the limit that it gives
    "missing": ("a value", "write it"),
    "extra_forbidden": ("no such key", "remove it"),
    **dict.fromkeys(("float_type", "float_parsing"), ("a number", "write one, without quotes")),
    **dict.fromkeys(("int_type", "int_parsing"), ("a whole number", "write one, without a point and quotes")),
    "int_from_float": ("a whole number", "round it"),
    **dict.fromkeys(("bool_type", "bool_parsing"), ("true or false", "write one of them, without quotes")),
    "string_type": ("a text", "put it in quotes"),
    "list_type": ("a list", "put it in brackets"),
    "tuple_type": ("a list", "put it in brackets"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type", "dataclass_type"), TABLE),
    "finite_number": ("a finite number", "write one"),
    "greater_than": ("a number above {gt:g}", "raise it"),
    "greater_than_equal": ("at least {ge}", "raise it"),
    "less_than": ("a number below {lt:g}", "lower it"),
    "less_than_equal": ("at most {le}", "lower it"),
    "too_short": ("at least {min_length} in the list", "write more"),
    "too_long": ("at most {max_length} in the list", "write fewer"),
    "string_too_short": ("a text of at least {min_length} letters", "write a longer one"),
    "string_too_long": ("a text of at most {max_length} letters", "write a shorter one"),
    "literal_error": ("{expected}", "choose one"),
}


def _part(parts: Registry, others: tuple[str, ...], name: str) -> str:
    if not (parts is LAWS and registry.is_policy(name)) and (fault := parts.fault(name, *others)):
        raise PydanticCustomError("fault", "{fault}", {"fault": fault})
    return name


def _ordered(span: tuple[float, float]) -> tuple[float, float]:
    if not span[0] <= span[1]:
        fault = f"expected [low, high] with low <= high, got {list(span)}; swap them"
        raise PydanticCustomError("fault", "{fault}", {"fault": fault})
    return span


ORDERED = AfterValidator(_ordered)
Range = Annotated[tuple[Delay, Delay], ORDERED]
Span = Annotated[tuple[Number, Number], ORDERED]
Bounds = Annotated[tuple[Limit, Limit], ORDERED]
Method = Annotated[str, AfterValidator(partial(_part, METHODS, ())), METHODS]
Law = Annotated[str, AfterValidator(partial(_part, DELAY_LAWS, (FROZEN,))), DELAY_LAWS]
Observes = Annotated[str, AfterValidator(partial(_part, OBSERVERS, ())), OBSERVERS]
Baseline = Annotated[str, AfterValidator(partial(_part, BASELINES, ())), BASELINES]
Kappa = Annotated[str, AfterValidator(partial(_part, LAWS, ())), LAWS]
Architecture = Annotated[str, AfterValidator(partial(_part, NETWORKS, ())), NETWORKS]
Runtime = Annotated[str, AfterValidator(partial(_part, RUNTIMES, ())), RUNTIMES]


def built(kind: type) -> BeforeValidator:
    """A validator that makes a dataclass of the library from a table; it checks its values itself."""

    def build(value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        for key in value.keys() - {field.name for field in fields(kind)}:
            raise PydanticCustomError("extra_forbidden", "{key}", {"key": key})
        if missing := [each.name for each in fields(kind) if each.default is MISSING and each.name not in value]:
            raise PydanticCustomError("fault", "{fault}", {"fault": f"expected {missing[0]}, got none; write it"})
        return kind(**value)

    return BeforeValidator(build)


def tables(kind: Any) -> list[type]:
    """The tables in the type of a key: classes of this file, and dataclasses of the library."""
    if isinstance(kind, type) and (is_dataclass(kind) or issubclass(kind, Section)):
        return [kind]
    return [table for part in get_args(kind) for table in tables(part)]


class Section(BaseModel):
    """A table of the pipeline file: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="constants")

    def map_paths(self, locate: Callable[[str], str]) -> Self:
        """The same with `locate(path)` in each value that names a class or another file."""
        return self.model_copy(update={key: map_paths(value, locate, key) for key, value in self})


def map_paths(value: Any, locate: Callable[[str], str], key: Any = None) -> Any:
    """A pipeline's value, plain or parsed, with `locate(path)` in each text that names a class or another file."""
    if isinstance(value, Section):
        return value.map_paths(locate)
    if isinstance(value, dict):
        return {name: map_paths(item, locate, name) for name, item in value.items()}
    if isinstance(value, list):
        return [map_paths(item, locate, key) for item in value]
    is_path = isinstance(value, str) and (
        registry.in_file(value) or registry.is_policy(value) or (key in FILES and value)
    )
    return locate(value) if is_path else value


def expected(error: Any) -> tuple[str, str]:
    """What an item of ValidationError.errors() expected, and what to do; what npred refuses says it itself."""
    if error["type"] not in EXPECTED:
        said, _, cure = error["msg"].removeprefix("Value error, ").removeprefix("expected ").partition("; ")
        return said.partition(", got ")[0], cure
    words, cure = EXPECTED[error["type"]]
    return words.format(**error.get("ctx", {})), cure
