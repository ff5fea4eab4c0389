"""Views of arrays: subscripts, and their elements."""

import ast
from dataclasses import replace
from typing import Any, NoReturn

from npred.symbolic.c99.values import (
    ZERO,
    Array,
    Const,
    Elementwise,
    Number,
    Several,
    Term,
    binary,
    text,
)


class Views:
    """The subscripts of one function's expressions."""

    unit: Any
    real: str

    def value(self, node: ast.AST) -> Any:
        """The value of an expression."""
        raise NotImplementedError

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Raise NotImplementedError for what the dialect does not have."""
        raise NotImplementedError

    def helper(self, name: str, kind: str) -> str:
        """The name of a helper for numbers of a kind, which the file then has."""
        return self.unit.helper(name, kind)

    def _Subscript(self, node: ast.Subscript) -> Any:
        owner = self.value(node.value)
        if isinstance(owner, Several):
            index = self.value(node.slice)
            return owner.items[index.value] if isinstance(index, Const) else self.refuse(node, "a tuple by a variable")
        view = self.view(owner, node)
        return self.element(view, []) if not view.shape else view

    def view(self, array: Array, node: ast.Subscript) -> Array:
        """The part of an array that a subscript names; without axes where it names an element."""
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        shape: list[Number] = []
        strides: list[int] = []
        offset = array.offset
        for axis, (extent, stride) in enumerate(zip(array.shape, array.strides, strict=True)):
            part = parts[axis] if axis < len(parts) else ast.Slice()
            if isinstance(part, ast.Slice):
                begin = self._edge(part.lower, extent, ZERO)
                end = self._edge(part.upper, extent, extent)
                shape.append(binary("-", end, begin, self.real))
                strides.append(stride)
            else:
                begin = self.wrapped(self.value(part), extent)
            offset = binary("+", offset, binary("*", begin, Const(stride, "int"), self.real), self.real)
        return replace(array, shape=tuple(shape), strides=tuple(strides), offset=offset)

    def _edge(self, node: ast.expr | None, extent: Number, otherwise: Number) -> Number:
        return otherwise if node is None else self.wrapped(self.value(node), extent)

    def wrapped(self, index: Number, extent: Number) -> Number:
        """An index that may count from the end."""
        if isinstance(index, Const) and isinstance(extent, Const):
            return Const(index.value + extent.value if index.value < 0 else index.value, "int")
        if index.low is not None and index.low >= 0:
            return index
        return Term(f"{self.helper('wrapped', 'int')}({text(index)}, {text(extent)})", "int", low=0)

    def element(self, value: Any, index: list[Number]) -> Number:
        """The element of an array or a function of arrays at an index; a number stands for all of them."""
        if isinstance(value, Elementwise):
            return value.element(index)
        if not isinstance(value, Array):
            return value
        at = value.offset
        for part, stride in zip(index[len(index) - len(value.shape) :], value.strides, strict=True):
            at = binary("+", at, binary("*", part, Const(stride, "int"), self.real), self.real)
        if (number := value.number(at)) is not None:
            return number
        self.unit.use(value)
        return Term(f"{value.name}[{text(at)}]", value.kind)
