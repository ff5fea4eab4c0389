"""One C file in the making: its functions, each for arguments of known shapes, their memory, constants and helpers."""

import ast
import re
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from npred.symbolic import kernels
from npred.symbolic.c99.body import Translation
from npred.symbolic.c99.library import BITS, HELPERS
from npred.symbolic.c99.values import (
    INTEGERS,
    ZERO,
    Array,
    Const,
    Foreign,
    Number,
    Several,
    Term,
    alike,
    exact,
    promoted,
)  # fmt: skip
from npred.symbolic.c99.variables import mangled

KIND_OF = {"float64": "double", "float32": "float"}


@dataclass
class Function:
    """A function of the file. `result` is a kind, the kinds of several results, or None."""

    name: str
    short: str
    names: list[str]
    statements: list[ast.stmt]
    globals: dict[str, Any]
    parameters: dict[str, Term | Array] = field(default_factory=dict)
    written: set[str] = field(default_factory=set)
    result: Any = None
    array_result: bool = False
    gives_arrays: bool = False
    memory: bool = False

    @property
    def kinds(self) -> dict[str, str]:
        """The kinds of its parameters."""
        return {name: value.kind for name, value in self.parameters.items()}

    def passed(self, arguments: list[Any]) -> list[tuple[Any, str]]:
        """Of the arguments of a call those that are passed in C, each with its name here."""
        return [(a, name) for a, name in zip(arguments, self.names, strict=True) if name in self.parameters]


class Unit:
    """The functions of a file whose names begin with `prefix`; `real` is the kind of Python's floats."""

    def __init__(self, prefix: str, real: str = "double") -> None:
        self.prefix, self.real = prefix, real
        self.functions: dict[Any, Function] = {}
        self.texts: list[str] = []
        self.structs: list[str] = []
        self.reserved: set[str] = set()
        self._helpers: dict[str, str] = {}
        self._constants: dict[int, Array] = {}
        self._kept: list[Any] = []  # what is known by its id stays alive
        self._used: dict[str, Array] = {}
        self._turns: dict[tuple[str, str], int] = {}

    def widen(self, where: str, name: str) -> int:
        """The number of times that a variable was found to hold more than was thought."""
        self._turns[where, name] = self._turns.get((where, name), 0) + 1
        return self._turns[where, name]

    def constant(self, value: Any, name: str) -> Any:
        """A number or array of NumPy: an array becomes one of the file where an element is not known at the export."""
        if not np.ndim(value):
            number = value.item()
            kinds = {"int32": "int32_t", "int64": "int", "bool": "bool", "float32": "float", "float64": self.real}
            return Const(number, kinds[str(value.dtype)])
        if id(value) not in self._constants:
            kind = KIND_OF[str(value.dtype)] if value.dtype == np.float32 else self.real
            c = f"{self.prefix}_{name.strip('_')}_{len(self._constants)}"
            self._constants[id(value)] = Array.whole(c, kind, value.shape, data=np.ascontiguousarray(value).reshape(-1))
            self._kept.append(value)
        return self._constants[id(value)]

    def use(self, array: Array) -> None:
        """Note that the text names an array: one of constants is then part of the file."""
        if array.data is not None:
            self._used[array.name] = array

    def helper(self, name: str, kind: str) -> str:
        """The name of a helper for a kind of numbers."""
        kind = "int" if kind == "bool" else kind
        c = f"{self.prefix}_{name}" + ("" if kind == "int" else f"_{kind}")
        integer = next((i for i, k in BITS.items() if k == kind), "")
        self._helpers[c] = HELPERS[name].format(kind=kind, name=c, integer=integer, f="f" * (kind == "float"))
        return c

    def function(self, function: Any, arguments: list[Any]) -> Function:
        """The function for arguments of these kinds and shapes, integers by value."""
        key = (id(function), *(_key(a) for a in arguments))
        if key not in self.functions:
            self._kept.append((function, arguments))
            self.functions[key] = self._translated(function, arguments)
        return self.functions[key]

    def _translated(self, function: Any, arguments: list[Any]) -> Function:
        definition, space = kernels.definition(function)
        names = [a.arg for a in definition.args.args]
        short = self._unique(definition.name.strip("_"))
        target = Function(f"{self.prefix}_{short}", short, names, definition.body, space)
        body = Translation(self, target.name, space, {n: _inside(n, a) for n, a in zip(names, arguments, strict=True)})
        target.parameters = {n: v for n, v in body.arguments.items() if _is_passed(v)}
        body.translate(definition.body)
        self._finish(target, body)
        return target

    def _unique(self, name: str) -> str:
        shorts, number, short = {f.short for f in self.functions.values()}, 1, name
        while short in shorts or short in self.reserved:
            number += 1
            short = f"{name}_{number}"
        self.reserved.add(short)
        return short

    def _finish(self, target: Function, body: Translation) -> None:
        """The function's text, and that of its memory."""
        target.written = body.written & set(target.parameters)
        target.memory = bool(body.members or body.callees)
        target.gives_arrays = any(_has_array(value) for value in body.returns)
        if target.gives_arrays:
            return
        target.result, target.array_result = _result(body.returns)
        if target.memory:
            self.structs.append(self.struct(target.name, body))
        lines = [f"{'    '}{line}" for line in body.top] + body.lines
        text = "\n".join(lines)
        unused = [f"    (void){c};" for c in self._arguments(target) if not _mentions(text, c)]
        head = f"static {_kind(target)} {target.name}({', '.join(self._arguments(target).values()) or 'void'})"
        self.texts.append("\n".join([head, "{", *unused, *lines, "}"]))

    def _arguments(self, target: Function) -> dict[str, str]:
        """The declarations of the parameters by their names in C."""
        arguments = {}
        for name, value in target.parameters.items():
            if isinstance(value, Array):
                const = "" if name in target.written else "const "
                arguments[value.name] = f"{const}{value.kind} *restrict {value.name}"
            else:
                arguments[value.text] = f"{'int' if value.kind == 'bool' else value.kind} {value.text}"
        if target.memory:
            arguments["memory"] = f"struct {target.name}_memory *restrict memory"
        if isinstance(target.result, list):
            if target.array_result:
                arguments["result"] = f"{target.result[0]} *restrict result"
            else:
                arguments |= {f"result{k}": f"{kind} *restrict result{k}" for k, kind in enumerate(target.result)}
        return arguments

    def struct(self, name: str, body: Translation) -> str:
        """The declaration of a function's memory: its own, and, one after the other, that of those it calls."""
        members = [f"    {member}" for member in body.members]
        if body.callees:
            parts = [f"        struct {f.name}_memory {f.short};" for f in body.callees.values()]
            members += ["    union {", *parts, "    } of;"]
        return "\n".join([f"struct {name}_memory {{", *members, "};"])

    def declarations(self) -> str:
        """Helpers, constants and functions, in an order in which C reads them."""
        constants = [constant(a.name, a.data, a.kind) for a in self._used.values() if a.data is not None]
        return "\n\n".join([*self._helpers.values(), *constants, *self.texts])

    @property
    def copies_bits(self) -> bool:
        """Whether the text needs memcpy."""
        return any("memcpy" in helper for helper in self._helpers.values())


def constant(name: str, values: np.ndarray, kind: str = "double") -> str:
    """A static array, its numbers exact in hexadecimal."""
    numbers = [exact(value, kind) for value in values.tolist()]
    rows = [", ".join(numbers[i : i + 6]) for i in range(0, len(numbers), 6)]
    return f"static const {kind} {name}[{len(numbers)}] = {{\n    " + ",\n    ".join(rows) + "\n};"


def _key(value: Any) -> Any:
    """What a function is translated anew for."""
    if isinstance(value, Const) and value.kind in INTEGERS:
        return value.kind, value.value
    if isinstance(value, Const | Term):
        return value.kind, value.low is not None and value.low >= 0
    if isinstance(value, Array) and value.data is not None:
        return id(value.data), value.extents, value.strides, value.offset
    if isinstance(value, Array):
        return value.kind, value.extents, value.strides, id(_passed_numbers(value))
    return id(value.value if isinstance(value, Foreign) else value)


def _inside(name: str, value: Any) -> Any:
    """An argument as the function sees it."""
    c = mangled(name)
    if isinstance(value, Array) and value.data is None:
        return replace(value, name=c, offset=ZERO, parameter=name, fixed=_passed_numbers(value))
    if isinstance(value, Term) or (isinstance(value, Const) and value.kind not in INTEGERS):
        counts = value.low is not None and value.low >= 0
        return Term(c, value.kind, low=0 if counts else None)
    return value


def _passed_numbers(array: Array) -> np.ndarray | None:
    """What a function knows of the numbers of a memory that it is passed: nothing where it is passed a part."""
    return array.fixed if array.offset == ZERO else None


def _is_passed(value: Any) -> bool:
    return isinstance(value, Term) or (isinstance(value, Array) and value.data is None)


def _has_array(value: Any) -> bool:
    return isinstance(value, Array) or (isinstance(value, Several) and any(map(_has_array, value.items)))


def _result(returns: list[Any]) -> tuple[Any, bool]:
    """The kind of the result, or the kinds of several, and whether those are an array."""
    values = [value for value in returns if value is not None]
    if not values:
        return None, False
    if not isinstance(values[0], Several):
        return promoted(*(v.kind for v in values)), False
    columns: list[tuple[Number, ...]] = list(zip(*(v.items for v in values), strict=True))
    return [promoted(*(v.kind for v in column)) for column in columns], alike(values[0])


def _kind(target: Function) -> str:
    return "void" if target.result is None or isinstance(target.result, list) else target.result.replace("bool", "int")


def _mentions(text: str, name: str) -> bool:
    return re.search(rf"\b{name}\b", text) is not None
