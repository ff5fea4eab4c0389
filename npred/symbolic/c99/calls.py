"""Calls and returns of functions in C."""

import ast
from typing import Any

from npred.symbolic.c99.values import (
    SUM,
    ZERO,
    Array,
    Const,
    Foreign,
    Several,
    Term,
    alike,
    text,
)
from npred.symbolic.c99.variables import Variables


class Calls(Variables):
    """The calls of a function's statements, and what it returns itself."""

    callees: dict[str, Any]
    returns: list[Any]
    breaks: list[str]

    def called(self, function: Any, arguments: list[Any], node: ast.AST) -> Any:
        target = self.unit.function(function, arguments)
        if target.gives_arrays:
            return self._inlined(target, arguments)
        texts = []
        if _share(target.passed(arguments), target.written):
            self.refuse(node, "arguments that share memory, which `restrict` forbids,")
        for value, name in target.passed(arguments):
            if isinstance(value, Array):
                self.unit.use(value)
                if name in target.written:
                    self.written.add(value.parameter)
                offset = "" if value.offset == ZERO else f" + {text(value.offset, SUM)}"
                texts.append(value.name + offset)
            else:
                texts.append(text(value, kind=target.kinds[name]))
        if target.memory:
            self.callees[target.name] = target
            texts.append(f"&memory->of.{target.short}")
        return self._result(target, texts)

    def _result(self, target: Any, texts: list[str]) -> Any:
        if not isinstance(target.result, list):
            call = f"{target.name}({', '.join(texts)})"
            if target.result:
                return Term(call, target.result)
            self.emit(f"{call};")
            return None
        if target.array_result:
            c = self._name("results")
            kind = target.result[0]
            self.scopes[-1][c] = f"{kind} []"
            self.emit(f"{kind} {c}[{len(target.result)}];")
            self.emit(f"{target.name}({', '.join([*texts, c])});")
            return Array.whole(c, kind, (len(target.result),))
        names = []
        for kind in target.result:
            self.parts += 1
            c = f"part_{self.parts}"
            self.emit(f"{kind} {c};")
            names.append(Term(c, kind))
        self.emit(f"{target.name}({', '.join([*texts, *('&' + n.text for n in names)])});")
        return Several(tuple(names))

    def _inlined(self, target: Any, arguments: list[Any]) -> Any:
        """A function that returns views: its lines stand here."""
        kind: Any = type(self)
        inner = kind(self.unit, target.name, target.globals, {})
        inner.outliving, inner.idle = set(), set()
        inner.env = dict(zip(target.names, arguments, strict=True))
        for attribute in ("lines", "depth", "members", "callees", "written", "scopes", "top", "breaks", "parts"):
            setattr(inner, attribute, getattr(self, attribute))
        *head, last = target.statements
        inner.block(head)
        assert isinstance(last, ast.Return) and last.value is not None, target.name
        result = inner.value(last.value)
        self.parts = inner.parts
        return result

    def _Return_(self, node: ast.Return) -> bool:
        value = None if node.value is None else self.value(node.value)
        if isinstance(value, Foreign):
            value = None
        self.returns.append(value)
        self._give(value)
        return True

    def _give(self, value: Any) -> None:
        if isinstance(value, Several):
            items = [self.temporary(item) if isinstance(item, Term) else item for item in value.items]
            for k, item in enumerate(items):
                if isinstance(item, Const | Term):
                    self.emit(f"{f'result[{k}]' if alike(value) else f'*result{k}'} = {text(item)};")
        self.emit(f"return {text(value)};" if isinstance(value, Const | Term) else "return;")


def _share(passed: list[tuple[Any, str]], written: set[str]) -> bool:
    """Whether an array that the function writes to may overlap another argument."""
    arrays = [(value, name) for value, name in passed if isinstance(value, Array)]
    return any(
        one.name == other.name and not _apart(one, other)
        for k, (one, first) in enumerate(arrays)
        for other, second in arrays[k + 1 :]
        if {first, second} & written
    )


def _apart(one: Array, other: Array) -> bool:
    """Whether two parts of a memory are known to have no element in common."""
    spans = []
    for array in (one, other):
        if not isinstance(array.offset, Const):
            return False
        last = sum((extent - 1) * stride for extent, stride in zip(array.extents, array.strides, strict=True))
        spans.append((array.offset.value, array.offset.value + last))
    (_, end), (begin, _) = sorted(spans)
    return end < begin
