"""Programs from a tape: forward derivatives, straight-line programs of the needed nodes, dependencies."""

import math
from collections.abc import Mapping, Sequence

from npred.formulas import Value
from npred.formulas.tables import Lookup
from npred.formulas.tape import OPS, Symbol, Vector, nonzero, tangent_of

KINKED = {"abs", "sign", "where", "maximum", "minimum", "floor", "mod", "atan2", "interp"}


def derivative(outputs: Vector, inputs: Vector, direction: Vector) -> list[Value]:
    """Forward mode: d/ds outputs(inputs + s direction) at s = 0, on the same tape."""
    tape = inputs[0].tape
    tangents: dict[int, Value] = {x.index: v for x, v in zip(inputs, direction, strict=True)}
    for index in _needed(outputs):
        op, args = tape.nodes[index]
        if index in tangents or op == "input":
            continue
        solution = tape.solution(index)
        if solution:
            tangents |= solution.tangent(tangents)
            continue
        seeds = [tangent_of(a, tangents) for a in args]
        if op in ("call", "item") and any(nonzero(s) for s in seeds if not isinstance(s, str)):
            if op == "item":  # the same of the function's derivative
                tangents[index] = tape.node("item", (seeds[0], args[1]))
                continue
            name, direct = args[:2]
            assert not any(nonzero(s) for s in seeds[2 + direct :]), f"d{name} is by its first {direct} arguments"
            tangents[index] = tape.node("call", (f"d{name}", 0, *args[2:], *seeds[2 : 2 + direct]))
        elif any(nonzero(s) for s in seeds):
            tangents[index] = OPS[op].tangent(*args, Symbol(tape, index), *seeds)
    return [tangent_of(y, tangents) for y in outputs]


def _needed(outputs: Vector) -> list[int]:
    """Indices of the nodes that the outputs depend on, in order of evaluation."""
    visited: set[int] = set()
    stack = [y for y in outputs if isinstance(y, Symbol)]
    while stack:
        symbol = stack.pop()
        if symbol.index not in visited:
            visited.add(symbol.index)
            stack.extend(a for a in symbol.tape.nodes[symbol.index][1] if isinstance(a, Symbol))
    return sorted(visited)


def lines(
    outputs: Vector, bindings: Mapping[str, str], targets: Sequence[str], texts: Mapping[str, str] = {}
) -> list[str]:
    """The lines that compute the outputs, results written to `targets`: inputs are read from `bindings` (name to text),
    those that are not in it from a variable of the same name.

    `texts` replaces the text of operations, for another language than Python. Variables are numbered in their order,
    so that the text does not depend on what else is on the tape.
    """
    symbols = [y for y in outputs if isinstance(y, Symbol)]
    assignments, names = [], {}
    for index in _needed(outputs):
        op, args = symbols[0].tape.nodes[index]
        match op:
            case "input":
                right = bindings.get(args[0], args[0])
            case "call":
                right = f"plant_{args[0]}({', '.join(_operand(a, names) for a in args[2:])})"
            case "item":
                right = f"{names[args[0].index]}[{args[1]}]"
            case _:
                right = texts.get(op, OPS[op].text).format(*(_operand(a, names) for a in args))
        names[index] = f"v{len(names)}"
        assignments.append(f"{names[index]} = {right}")
    return assignments + [f"{target} = {_operand(y, names)}" for target, y in zip(targets, outputs, strict=True)]


def _operand(a: Value, names: dict[int, str]) -> Value:
    """What stands for an argument in a text; a table is written by the text's own format."""
    if isinstance(a, Symbol):
        return names[a.index]
    if isinstance(a, Lookup):
        return a
    if isinstance(a, bool):
        return repr(a)
    return f"({float(a)!r})" if math.isfinite(a) else f"(np.{float(a)!r})".replace("np.-", "-np.")


def depends(outputs: Vector, symbols: Vector) -> bool:
    """True if any output needs any of those inputs."""
    return not {s.index for s in symbols}.isdisjoint(_needed(outputs))


def kinks(outputs: Vector, inputs: Vector) -> list[str]:
    """The operations without a derivative somewhere by which the outputs depend on those inputs, each named once."""
    operations = set()
    tape = inputs[0].tape
    for index in _needed(outputs):
        op, args = tape.nodes[index]
        if op == "call" and args[0] in tape.networks and depends(args[2:], inputs):
            operations |= tape.networks[args[0]].kinks
        decided = args[:1] if op == "where" else args
        if op in KINKED and depends(decided, inputs):
            operations.add(op)
    return sorted(operations)
