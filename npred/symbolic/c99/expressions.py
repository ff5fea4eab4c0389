"""Expressions of a kernel in C: what is known at the export is computed, the rest becomes text."""

import ast
import builtins
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np

from npred.symbolic.c99 import library
from npred.symbolic.c99.operations import LinesOfC
from npred.symbolic.c99.values import (
    AND,
    ATOM,
    COMPARE,
    INTEGERS,
    OR,
    PRODUCT,
    TERNARY,
    UNARY,
    Array,
    Const,
    Elementwise,
    Fields,
    Foreign,
    Number,
    Several,
    Term,
    binary,
    folded,
    promoted,
    text,
)
from npred.symbolic.c99.views import Views

SYMBOLS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.LShift: "<<"}
COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
FOLDED = {
    "<": lambda a, b: a < b, "<=": lambda a, b: a <= b, ">": lambda a, b: a > b, ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b, "!=": lambda a, b: a != b,
}  # fmt: skip


class Expressions(Views):
    """The expressions of one function. Its statements are those of npred.symbolic.c99.body."""

    globals: dict[str, Any]
    env: dict[str, Any]
    where: str  # the function's name

    def value(self, node: ast.AST) -> Any:
        """The value of an expression. Raises NotImplementedError, with its line, for what the dialect does not have."""
        method: Any = getattr(self, f"_{type(node).__name__}", None)
        if method is None:
            self.refuse(node, type(node).__name__)
        return method(node)

    def refuse(self, node: ast.AST, what: str) -> NoReturn:
        """Raise NotImplementedError."""
        line = getattr(node, "lineno", 0)
        raise NotImplementedError(f"{self.where}, line {line}: expected a kernel's dialect, got {what}; add it to c99")

    def _Constant(self, node: ast.Constant) -> Any:
        kinds = {bool: "bool", int: "int", float: self.real}
        kind = kinds.get(type(node.value))
        return Const(node.value, kind) if kind else Foreign(node.value)

    def _Name(self, node: ast.Name) -> Any:
        if node.id in self.env:
            return self.env[node.id]
        builtin = vars(builtins).get(node.id)
        if node.id not in self.globals and builtin is None:
            self.refuse(node, f"the name {node.id}, which is not set on every path")
        return self.known(self.globals.get(node.id, builtin), node.id)

    def known(self, thing: Any, name: str) -> Any:
        """A Python object as a value: numbers and arrays are constants of the export."""
        kinds = {bool: "bool", int: "int", float: self.real}
        if type(thing) in kinds:
            return Const(thing, kinds[type(thing)])
        if isinstance(thing, np.ndarray | np.generic):
            return self.unit.constant(thing, name)
        fields = getattr(thing, "_asdict", None)
        return Fields({k: self.known(v, k) for k, v in fields().items()}) if fields else Foreign(thing)

    def _Attribute(self, node: ast.Attribute) -> Any:
        owner = self.value(node.value)
        if isinstance(owner, Fields):
            return owner.fields[node.attr]
        if isinstance(owner, Array) and node.attr == "shape":
            return Several(owner.shape)
        if isinstance(owner, Foreign):
            return self.known(getattr(owner.value, node.attr), node.attr)
        return self.refuse(node, f"the attribute {node.attr}")

    def _Tuple(self, node: ast.Tuple) -> Any:
        return Several(tuple(self.value(item) for item in node.elts))

    def _BinOp(self, node: ast.BinOp) -> Any:
        a, b = self.value(node.left), self.value(node.right)
        if isinstance(a, Array | Elementwise) or isinstance(b, Array | Elementwise):
            shape = next(x.shape for x in (a, b) if isinstance(x, Array | Elementwise))
            return Elementwise(
                shape, lambda index: self.operation(node, self.element(a, index), self.element(b, index))
            )
        return self.operation(node, a, b)

    def operation(self, node: Any, a: Number, b: Number) -> Number:
        """a op b of two numbers."""
        symbol = SYMBOLS.get(type(node.op))
        if symbol:
            return binary(symbol, a, b, self.real)
        if isinstance(node.op, ast.Pow):
            return self.power(a, b)
        name = {ast.Mod: "modulo", ast.FloorDiv: "quotient"}.get(type(node.op), "")
        kind = promoted(a.kind, b.kind)
        if name == "modulo" and kind not in INTEGERS:
            return Term(f"{self.helper('remainder', kind)}({text(a, kind=kind)}, {text(b, kind=kind)})", kind)
        if not name or kind not in INTEGERS:
            return self.refuse(node, type(node.op).__name__)
        if isinstance(a, Const) and isinstance(b, Const):
            return Const(a.value % b.value if name == "modulo" else a.value // b.value, "int")
        divisor = b.value if isinstance(b, Const) and b.value > 0 else None
        high = divisor - 1 if divisor and name == "modulo" else None
        if divisor and a.low is not None and a.low >= 0:
            return replace(_plain(name, a, b), low=0, high=high)
        low = 0 if high is not None else None
        return Term(f"{self.helper(name, 'int')}({text(a)}, {text(b)})", "int", low=low, high=high)

    def power(self, a: Number, b: Number) -> Number:
        """Whole powers as Numba has them, by squaring; others by pow."""
        if isinstance(a, Const) and isinstance(b, Const):
            return folded("**", a, b, self.real)
        if isinstance(b, Const) and b.kind in INTEGERS and 1 <= b.value <= 8:
            base, whole, result = self.atom(a), b.value, None
            while whole:
                if whole & 1:
                    result = base if result is None else binary("*", result, base, self.real)
                whole >>= 1
                base = self.atom(binary("*", base, base, self.real)) if whole else base
            return result  # type: ignore[return-value]
        kind = promoted(a.kind, b.kind, self.real if a.kind in INTEGERS else a.kind)
        return Term(f"pow{'f' * (kind == 'float')}({text(a, kind=kind)}, {text(b, kind=kind)})", kind)

    def _UnaryOp(self, node: ast.UnaryOp) -> Any:
        a = self.value(node.operand)
        if isinstance(node.op, ast.Not):
            return Const(not a.value, "bool") if isinstance(a, Const) else Term(f"!{text(a, UNARY)}", "bool", UNARY)
        if isinstance(node.op, ast.UAdd):
            return a
        return self.negative(a)

    @staticmethod
    def negative(a: Number) -> Number:
        """-a."""
        if isinstance(a, Const):
            return Const(-a.value, promoted(a.kind, "int"))
        ends = {"low": None if a.high is None else -a.high, "high": None if a.low is None else -a.low}
        return Term(f"-{text(a, ATOM)}", a.kind, UNARY, **ends)

    def _Compare(self, node: ast.Compare) -> Any:
        parts = [self.value(part) for part in (node.left, *node.comparators)]
        if isinstance(node.ops[0], ast.Is | ast.IsNot):
            same = parts[0].value is parts[1].value if isinstance(parts[0], Foreign) else False
            return Const(same == isinstance(node.ops[0], ast.Is), "bool")
        tests = [
            self.compared(COMPARISONS[type(op)], *pair)
            for op, pair in zip(node.ops, zip(parts, parts[1:], strict=False), strict=True)
        ]
        return _joined("&&", tests)

    @staticmethod
    def compared(symbol: str, a: Number, b: Number) -> Number:
        """a symbol b."""
        if isinstance(a, Const) and isinstance(b, Const):
            return Const(bool(FOLDED[symbol](a.value, b.value)), "bool")
        kind = promoted(a.kind, b.kind)
        level = COMPARE + 1
        return Term(f"{text(a, level, kind)} {symbol} {text(b, level, kind)}", "bool", COMPARE)

    def _BoolOp(self, node: ast.BoolOp) -> Any:
        return _joined("&&" if isinstance(node.op, ast.And) else "||", [self.value(part) for part in node.values])

    def _IfExp(self, node: ast.IfExp) -> Any:
        test = self.value(node.test)
        if isinstance(test, Const):
            return self.value(node.body if test.value else node.orelse)
        return self.chosen(test, self.value(node.body), self.value(node.orelse))

    def chosen(self, test: Number, a: Number, b: Number) -> Number:
        """a where the test holds, else b."""
        if isinstance(test, Const):
            return a if test.value else b
        kind = promoted(a.kind, b.kind)
        low = None if a.low is None or b.low is None else min(a.low, b.low)
        written = f"{text(test, TERNARY + 1)} ? {text(a, TERNARY + 1, kind)} : {text(b, TERNARY, kind)}"
        return Term(written, kind, TERNARY, low)

    def _Call(self, node: ast.Call) -> Any:
        if isinstance(node.func, ast.Attribute) and (result := self._method(node.func, node)) is not None:
            return result
        function = self.value(node.func)
        if not isinstance(function, Foreign):
            return self.refuse(node, "a call of what is no function")
        arguments = [self.value(part) for part in node.args]
        if isinstance(memory := getattr(function.value, "memory", None), str | np.ndarray):
            return self._intrinsic(memory, arguments)
        if (program := getattr(function.value, "program", None)) is not None:
            o = LinesOfC(self)
            return Several(tuple(o.number(result) for result in program(o, *arguments[0].items)))
        if getattr(function.value, "__name__", "") == "carray":
            return arguments[0]
        result = library.call(self, function.value, arguments)
        if result is not None:
            return result
        return self.called(function.value, arguments, node)

    def _intrinsic(self, memory: Any, arguments: list[Any]) -> Any:
        """What an intrinsic of the dialect stands for: constants, a buffer of a kind, or, in C, nothing."""
        if isinstance(memory, np.ndarray):
            return self.unit.constant(memory, "weights")
        return self.buffer([arguments[0].value], "float" if memory == "float32" else self.real) if memory else None

    def _method(self, function: ast.Attribute, node: ast.Call) -> Any:
        """x.reshape(shape) of an array, x.view(type) of an integer's bits."""
        if function.attr not in ("reshape", "view"):
            return None
        owner, arguments = self.value(function.value), [self.value(part) for part in node.args]
        if isinstance(owner, Array) and function.attr == "reshape":
            sizes = arguments[0].items if isinstance(arguments[0], Several) else arguments
            return owner.reshaped(tuple(size.value for size in sizes))
        if isinstance(owner, Term) and function.attr == "view":
            kind = library.BITS[owner.kind]
            return Term(f"{self.helper('bits', kind)}({text(owner)})", kind)
        return None

    def temporary(self, value: Number) -> Number:
        """A variable that holds the number."""
        raise NotImplementedError

    def atom(self, number: Number) -> Number:
        """The number, or a variable that holds it: for text that names it more than once."""
        raise NotImplementedError

    def buffer(self, sizes: list[int], kind: str) -> Array:
        """Memory of the function."""
        raise NotImplementedError

    def called(self, function: Any, arguments: list[Any], node: ast.AST) -> Any:
        """The result of a call of another function of the dialect."""
        raise NotImplementedError


def _plain(name: str, a: Number, b: Number) -> Term:
    """% and // of what is not negative."""
    symbol = "%" if name == "modulo" else "/"
    return Term(f"{text(a, PRODUCT)} {symbol} {text(b, PRODUCT + 1)}", "int", PRODUCT)


def _joined(symbol: str, tests: list[Number]) -> Number:
    """Tests joined by && or ||, without those that are decided."""
    ends = symbol == "||"  # the value of a test that decides them all
    open_tests = []
    for test in tests:
        if not isinstance(test, Const):
            open_tests.append(test)
        elif bool(test.value) == ends:
            open_tests.append(test)
            break
    if not open_tests:
        return Const(not ends, "bool")
    if len(open_tests) == 1 or isinstance(open_tests[0], Const):
        return open_tests[0]
    level = AND if symbol == "&&" else OR
    inner = COMPARE if symbol == "||" else level + 1
    written = f" {symbol} ".join(text(test, inner) for test in open_tests)
    return Term(written, "bool", level)
