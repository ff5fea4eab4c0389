"""Loops and branches in C."""

import ast
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from npred.symbolic.c99 import liveness
from npred.symbolic.c99.calls import Calls
from npred.symbolic.c99.values import (
    SUM,
    ZERO,
    Const,
    Number,
    Several,
    Term,
    text,
)


class Branches(Calls):
    """The statements that hold others."""

    def _assign(self, target: ast.expr, value: Any, node: ast.Assign) -> None:
        """Set what stands left of an assignment."""
        raise NotImplementedError

    def block(self, statements: Sequence[ast.stmt]) -> bool:
        """The statements; True if what follows them is not reached."""
        for statement in statements:
            method: Any = getattr(self, f"_{type(statement).__name__}_", None)
            if method is None:
                self.refuse(statement, type(statement).__name__)
            if method(statement):
                return True
        return False

    def nested(self, statements: Sequence[ast.stmt]) -> bool:
        """A block in braces, which the caller writes."""
        before, self.depth = dict(self.env), self.depth + 1
        self.scopes.append({})
        ends = self.block(statements)
        self.scopes.pop()
        self.depth -= 1
        self.env = before | {name: self.env[name] for name in self.outliving if name in self.env}
        return ends

    def _If_(self, node: ast.If) -> bool:
        test = self.value(node.test)
        if isinstance(test, Const):
            return self.block(node.body if test.value else node.orelse)
        self.emit(f"if ({text(test)}) {{")
        ends = self.nested(node.body)
        if node.orelse:
            self.emit("} else {")
            ends = self.nested(node.orelse) and ends
        self.emit("}")
        return ends and bool(node.orelse)

    def _While_(self, node: ast.While) -> None:
        count = len(self.lines)
        test = self.value(node.test)
        if len(self.lines) > count or node.orelse:
            self.refuse(node, "a condition of a loop that takes lines")
        self.emit(f"while ({text(test)}) {{")
        self.breaks.append("")
        self.nested(node.body)
        self.breaks.pop()
        self.emit("}")

    def _Break_(self, node: ast.Break) -> bool:
        if self.breaks[-1]:
            self.emit(f"{self.breaks[-1]} = 1;")
        self.emit("break;")
        return True

    def _Continue_(self, node: ast.Continue) -> bool:
        self.emit("continue;")
        return True

    def _For_(self, node: ast.For) -> None:
        assert isinstance(node.iter, ast.Call) and isinstance(node.iter.func, ast.Name), self.where
        arguments = [self.value(part) for part in node.iter.args]
        if node.iter.func.id == "enumerate":
            return self._enumerate(node, arguments[0])
        start, stop, step = [*([ZERO] if len(arguments) == 1 else []), *arguments, *[Const(1, "int")] * 2][:3]
        turns = self._turns(start, stop, step)
        single = turns is not None and len(turns) <= 1 and not liveness.jumps(node)
        if turns is not None and (single or liveness.written_out(node) is not None):
            for turn in turns:
                self._assign(node.target, Const(turn, "int"), node)  # type: ignore[arg-type]
                self.block(node.body)
            self.block(node.orelse)
            return None
        return self._counted(node, start, stop, step)

    @staticmethod
    def _turns(*arguments: Number) -> range | None:
        numbers = [a.value for a in arguments if isinstance(a, Const)]
        return range(*numbers) if len(numbers) == len(arguments) else None

    def _counted(self, node: ast.For, start: Number, stop: Number, step: Number) -> None:
        assert isinstance(node.target, ast.Name) and isinstance(step, Const), self.where
        name = "turn" if node.target.id == "_" else node.target.id
        stop = stop if isinstance(stop, Const) else self.temporary(stop)
        flag = self._flag() if node.orelse else ""
        lasting = node.target.id in self.outliving
        c = self._name(name + "_now" if lasting else name)
        self.scopes.append({c: "int"})
        rises = step.value > 0
        change = f"{c}++" if step.value == 1 else f"{c} {'+' if rises else '-'}= {abs(step.value)}"
        self.emit(f"for (int {c} = {text(start)}; {c} {'<' if rises else '>'} {text(stop, SUM)}; {change}) {{")
        inside = Term(c, "int", low=start.low if rises else None, high=None)
        if not rises and isinstance(stop, Const):
            inside = replace(inside, low=stop.value + 1)
        self.depth += 1
        if lasting:
            self._set(node.target.id, inside)
        else:
            self.env[node.target.id] = inside
        self.depth -= 1
        self.breaks.append(flag)
        self.nested(node.body)
        self.breaks.pop()
        self.scopes.pop()
        self.emit("}")
        if flag:
            self.emit(f"if (!{flag}) {{")
            self.nested(node.orelse)
            self.emit("}")

    def _flag(self) -> str:
        c = self._name("ended")
        self.scopes[-1][c] = "int"
        self.emit(f"int {c} = 0;")
        return c

    def _enumerate(self, node: ast.For, value: Any) -> None:
        """for k, item in enumerate(…), of a tuple of numbers or of an array's elements."""
        array = self._tuple("items", value) if isinstance(value, Several) else value
        assert isinstance(node.target, ast.Tuple)
        index, item = node.target.elts
        assert isinstance(index, ast.Name)
        head = ast.Assign(
            [item], ast.Subscript(ast.Name("items_", ast.Load()), ast.Name(index.id, ast.Load()), ast.Load())
        )
        self.env["items_"] = array
        count = array.shape[0]
        loop = ast.For(index, node.iter, [head, *node.body], node.orelse)
        self._counted(loop, ZERO, count, Const(1, "int"))
