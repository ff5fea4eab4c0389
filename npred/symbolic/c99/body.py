"""The statements of a kernel in C."""

import ast
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from npred.symbolic.c99 import liveness
from npred.symbolic.c99.expressions import Expressions
from npred.symbolic.c99.values import (
    ATOM,
    INTEGERS,
    SUM,
    ZERO,
    Array,
    Const,
    Elementwise,
    Foreign,
    Number,
    Several,
    Term,
    alike,
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


class Translation(Expressions):
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
        while idle := _only_written(self.lines, {_declared(line) for line in [*self.top, *self.members]}):
            self.lines = [line for line in self.lines if _written(line) not in idle]
            self.top = [line for line in self.top if _declared(line) not in idle]
            self.members = [line for line in self.members if _declared(line) not in idle]

    def _take(self, name: str, value: Any) -> None:
        """An argument: one that outlives a block is a variable like others."""
        if isinstance(value, Term):
            self.scopes[0][value.text] = value.kind
        if name in self.outliving and isinstance(value, Const | Term):
            if isinstance(value, Term):
                self.facts.setdefault(name, replace(value, low=None, high=None))
            self.env.pop(name)
            self._set(name, value)

    def emit(self, line: str) -> None:
        self.lines.append("    " * self.depth + line)

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
        head = ast.Assign([item], ast.Subscript(ast.Name("items_", ast.Load()), index_read(index), ast.Load()))
        self.env["items_"] = array
        count = array.shape[0]
        loop = ast.For(index, node.iter, [head, *node.body], node.orelse)
        self._counted(loop, ZERO, count, Const(1, "int"))

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

    def called(self, function: Any, arguments: list[Any], node: ast.AST) -> Any:
        target = self.unit.function(function, arguments)
        if target.gives_arrays:
            return self._inlined(target, arguments)
        texts = []
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
        inner = Translation(self.unit, target.name, target.globals, {})
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


def index_read(index: ast.Name) -> ast.Name:
    return ast.Name(index.id, ast.Load())


def _assigned(target: ast.Tuple) -> set[str]:
    """The names that an assignment to several targets changes: variables, and arrays of which it changes a part."""
    return {part.id for part in ast.walk(target) if isinstance(part, ast.Name)}


def mangled(name: str) -> str:
    """A name of Python as one of C."""
    return f"{name}_" if KEYWORDS.fullmatch(name) else name


WRITES = re.compile(r"\s*(?P<kind>(?:const )?(?:int|float|double|int32_t|int64_t) )?(?:memory->)?(?P<name>\w+)"
                    r"(?:\[[^;=]*\])? [-+*/]?= [^;]*;")  # fmt: skip


def _written(line: str) -> str:
    """The variable that a line sets and does not read; empty for other lines."""
    match = WRITES.fullmatch(line)
    name = match["name"] if match else ""
    return name if name and len(re.findall(rf"\b{name}\b", line)) == 1 else ""


def _declared(line: str) -> str:
    return re.split(r"\W+", line)[1]


def _only_written(lines: list[str], names: set[str]) -> set[str]:
    """Of these variables, and of those that are declared in the lines, the ones that no line reads."""
    names = names | {_written(line) for line in lines if (match := WRITES.fullmatch(line)) and match["kind"]}
    read: set[str] = set()
    for line in lines:
        read |= set(re.findall(r"\w+", line)) - {_written(line)}
    return names - read - {""}
