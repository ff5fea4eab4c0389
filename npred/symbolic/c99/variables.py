"""The variables and buffers of a function in C: where each is declared, and what is written to them."""

import ast
import re
from dataclasses import replace
from typing import Any

from npred.symbolic.c99.expressions import Expressions
from npred.symbolic.c99.values import (
    ATOM,
    INTEGERS,
    SUM,
    ZERO,
    Array,
    Const,
    Elementwise,
    Number,
    Several,
    Term,
    promoted,
    text,
)

KEYWORDS = re.compile(
    "auto|break|case|char|const|continue|default|do|double|else|enum|extern|float|for|goto|if|inline|int|long|memory|"
    "register|restrict|return|short|signed|sizeof|static|struct|switch|typedef|union|unsigned|void|volatile|while"
)
ON_STACK = 32  # numbers of a buffer that is a local array; a longer one is part of the controller's memory
PASSES = 20


class Widened(Exception):
    """A variable was found to hold more than was thought: the function is translated again."""


class Variables(Expressions):
    """The lines of a function so far, and the names that they have declared."""

    outliving: set[str]  # the variables that are read after the block that sets them
    facts: dict[str, Term]  # of those: kind and bounds
    lines: list[str]
    top: list[str]
    members: list[str]
    written: set[str]
    scopes: list[dict[str, str]]
    depth: int
    parts: int

    def emit(self, line: str) -> None:
        self.lines.append("    " * self.depth + line)

    def _set(self, name: str, value: Any) -> None:
        """Bind a name: constants, arrays and functions by value; numbers to a variable of C."""
        if name == "_":
            return
        if isinstance(value, Several) and value.items and all(isinstance(x, Const | Term) for x in value.items):
            value = self._tuple(name, value)
        if isinstance(value, Array) and isinstance(value.offset, Term):
            value = replace(value, offset=self.temporary(value.offset))
        if not isinstance(value, Const | Term):
            if isinstance(value, Elementwise):
                raise NotImplementedError(f"{self.where}: expected {name} to be written into an array")
            self.env[name] = value
        elif name in self.outliving:
            self._set_outliving(name, value)
        elif isinstance(value, Const):
            self.env[name] = value
        else:
            self.env[name] = self._variable(name, value)

    def _tuple(self, name: str, value: Several) -> Array:
        """A tuple of numbers as a local array, which a loop may index."""
        kind = promoted(*(item.kind for item in value.items))
        c = self._name(name)
        self.scopes[-1][c] = f"{kind} []"
        self.emit(f"const {kind} {c}[] = {{{', '.join(text(item, kind=kind) for item in value.items)}}};")
        return Array.whole(c, kind, (len(value.items),))

    def _set_outliving(self, name: str, value: Number) -> None:
        low = value.low if value.kind in INTEGERS else None
        fact = self.facts.get(name)
        if fact is None:
            fact = self.facts[name] = Term(mangled(name), value.kind, low=low)
        kind = promoted(fact.kind, value.kind)
        bound = None if fact.low is None or low is None else min(fact.low, low)
        if kind not in INTEGERS:
            bound = None
        if (kind, bound) != (fact.kind, fact.low):  # bounds that fall and fall are none
            turn = self.unit.widen(self.where, name)
            self.facts[name] = replace(fact, kind=kind, low=bound if turn < PASSES // 4 else None)
            raise Widened
        if fact.text not in self.scopes[0]:
            self.scopes[0][fact.text] = kind
            self.top.append(f"{'int' if kind == 'bool' else kind} {fact.text} = 0;")
        self.emit(f"{fact.text} = {text(value, kind=kind)};")
        self.env[name] = fact

    def _variable(self, name: str, value: Term) -> Term:
        """A variable that lives in this block, or one of that name around it which nothing reads any more."""
        kind, c = "int" if value.kind == "bool" else value.kind, mangled(name)
        owner = next((scope for scope in reversed(self.scopes) if c in scope), None)
        if owner is not None and owner[c] == kind:
            self.emit(f"{c} = {text(value)};")
        else:
            c = self._name(name)
            self.scopes[-1][c] = kind
            self.emit(f"{kind} {c} = {text(value)};")
        return replace(value, text=c, level=ATOM)

    def _name(self, name: str) -> str:
        """A name in C that no variable around has."""
        c, number = mangled(name), 1
        lasting = {mangled(other) for other in self.outliving}
        while any(c in scope for scope in self.scopes) or c in self.unit.reserved or c in lasting:
            number += 1
            c = f"{mangled(name)}_{number}"
        return c

    def temporary(self, value: Number) -> Number:
        if isinstance(value, Const):
            return value
        self.parts += 1
        c = f"part_{self.parts}"
        self.emit(f"const {'int' if value.kind == 'bool' else value.kind} {c} = {text(value)};")
        return replace(value, text=c, level=ATOM)

    def atom(self, number: Number) -> Number:
        plain = isinstance(number, Const) or re.fullmatch(r"\w+", number.text)
        return number if plain else self.temporary(number)

    def _store(self, target: ast.Subscript, value: Any, symbol: str = "") -> None:
        """Write elements, by loops where the target has axes."""
        owner = self.value(target.value)
        if not isinstance(owner, Array):
            self.refuse(target, "an assignment to part of what is no array")
        view = self.view(owner, target)
        self._fill(view, value, symbol)

    def _fill(self, view: Array, value: Any, symbol: str = "") -> None:
        self.written.add(view.parameter)
        value = self.atom(value) if isinstance(value, Term) and view.shape else value
        index: list[Number] = []
        for extent in view.shape:
            if isinstance(extent, Const) and extent.value == 1:
                index.append(ZERO)
                continue
            c = self._name("i")
            self.scopes.append({c: "int"})
            self.emit(f"for (int {c} = 0; {c} < {text(extent, SUM)}; {c}++) {{")
            self.depth += 1
            index.append(Term(c, "int", low=0))
        place = self.element(replace(view, data=None), index)
        source = self.element(value, index)
        self.emit(f"{place.text} {symbol}= {text(source, kind=place.kind)};")  # type: ignore[union-attr]
        for part in reversed(index):
            if part is not ZERO:
                self.depth -= 1
                self.scopes.pop()
                self.emit("}")

    def buffer(self, sizes: list[int], kind: str) -> Array:
        array = Array.whole("", kind, tuple(sizes))
        count = max(array.size, 1)
        if count <= ON_STACK:
            c = self._name("local")
            self.scopes[0][c] = f"{kind} []"
            self.top.append(f"{kind} {c}[{count}];")
            return replace(array, name=c)
        c = f"b{len(self.members)}"
        self.members.append(f"{kind} {c}[{count}];")
        return replace(array, name=f"memory->{c}")


def mangled(name: str) -> str:
    """A name of Python as one of C."""
    return f"{name}_" if KEYWORDS.fullmatch(name) else name
