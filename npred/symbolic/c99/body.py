"""One function in C: its statements, in order."""

import ast
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from npred.symbolic.c99 import liveness
from npred.symbolic.c99.branches import Branches
from npred.symbolic.c99.idle_lines import declared, only_written, written
from npred.symbolic.c99.values import (
    ATOM,
    Array,
    Const,
    Several,
    Term,
    text,
)
from npred.symbolic.c99.variables import PASSES, Widened


class Translation(Branches):
    """One function for arguments of known shapes: its lines, what it returns and the memory that it needs."""

    def __init__(self, unit: Any, where: str, globals_: dict[str, Any], arguments: dict[str, Any]) -> None:
        self.unit, self.where, self.globals, self.real = unit, where, globals_, unit.real
        self.arguments = arguments
        self.facts: dict[str, Term] = {}  # of the variables that outlive a block: kind and bounds

    def translate(self, statements: Sequence[ast.stmt]) -> None:
        """Translate, again where a variable turns out to hold other kinds of numbers."""
        statements = [s for s in statements if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
        lives = liveness.Lives(statements)
        self.outliving, self.idle = lives.outliving, lives.idle
        for _ in range(PASSES):
            try:
                return self._pass(statements)
            except Widened:
                continue
        raise NotImplementedError(f"{self.where}: expected variables of one kind each")

    def _pass(self, statements: Sequence[ast.stmt]) -> None:
        self.lines: list[str] = []
        self.depth = 1
        self.parts = 0
        self.env = dict(self.arguments)
        self.members: list[str] = []
        self.callees: dict[str, Any] = {}
        self.returns: list[Any] = []
        self.written: set[str] = set()
        self.scopes: list[dict[str, str]] = [{}]
        self.top: list[str] = []
        self.breaks: list[str] = []
        for name, value in self.arguments.items():
            self._take(name, value)
        self.block(statements)
        self._drop_unused()

    def _drop_unused(self) -> None:
        """Leave out variables and buffers that nothing reads: those of branches that are not taken."""
        while idle := only_written(self.lines, {declared(line) for line in [*self.top, *self.members]}):
            self.lines = [line for line in self.lines if written(line) not in idle]
            self.top = [line for line in self.top if declared(line) not in idle]
            self.members = [line for line in self.members if declared(line) not in idle]

    def _take(self, name: str, value: Any) -> None:
        """An argument: one that outlives a block is a variable like others."""
        if isinstance(value, Term):
            self.scopes[0][value.text] = value.kind
        if name in self.outliving and isinstance(value, Const | Term):
            if isinstance(value, Term):
                self.facts.setdefault(name, replace(value, low=None, high=None))
            self.env.pop(name)
            self._set(name, value)

    def _Expr_(self, node: ast.Expr) -> None:
        value = self.value(node.value)
        if isinstance(value, Term):
            self.emit(f"(void){text(value, ATOM)};")

    def _Pass_(self, node: ast.Pass) -> None:
        pass

    def _Assign_(self, node: ast.Assign) -> None:
        value = self.value(node.value)
        for target in () if node in self.idle else node.targets:
            self._assign(target, value, node)
            if len(node.targets) > 1 and isinstance(target, ast.Name):
                value = self.env[target.id]

    def _assign(self, target: ast.expr, value: Any, node: ast.Assign) -> None:
        if isinstance(target, ast.Name):
            self._set(target.id, value)
        elif isinstance(target, ast.Subscript):
            self._store(target, value)
        elif isinstance(target, ast.Tuple):
            items = self._items(value)
            if liveness.reads(node.value) & _assigned(target):
                items = [self.temporary(item) if isinstance(item, Term) else item for item in items]
            for part, item in zip(target.elts, items, strict=True):
                self._assign(part, item, node)

    def _items(self, value: Any) -> list[Any]:
        if isinstance(value, Several):
            return list(value.items)
        return [self.element(value, [Const(k, "int")]) for k in range(value.extents[0])]

    def _AugAssign_(self, node: ast.AugAssign) -> None:
        value = self.value(node.value)
        symbols = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
        if isinstance(node.target, ast.Subscript):
            self._store(node.target, value, symbols[type(node.op)])
            return
        assert isinstance(node.target, ast.Name)
        before = self.env[node.target.id]
        if isinstance(before, Array):
            self._fill(before, value, symbols[type(node.op)])
        else:
            self._set(node.target.id, self.operation(node, before, value))


def _assigned(target: ast.Tuple) -> set[str]:
    """The names that an assignment to several targets changes: variables, and arrays of which it changes a part."""
    return {part.id for part in ast.walk(target) if isinstance(part, ast.Name)}
