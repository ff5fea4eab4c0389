"""Formulas of a plant, printed as C functions on strided memory.

A function reads component k of a vector x at x[k * stride]: lanes lie innermost, so that the calls of a loop over lanes
become the instructions of a processor's vectors once the function is inlined.

Functions that call a costly plant's own functions, for several lanes: loops over lanes between the calls.

Inlined in a loop over lanes, a call ends what a compiler makes of that loop. So the lanes of a GROUP go together from
one call to the next: what is needed later is an array with a number for each lane.
"""

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from npred.formulas import called_functions, programs
from npred.formulas.tape import Vector
from npred.formulas.trace import Trace
from npred.kernels import network
from npred.kernels.statements import CALLED, LOOP, TEXTS, statement

HEAD = "static INLINED void {name}({arguments})\n{{\n    {lines}\n}}\n"
# for a function that calls others: for `count` lanes, each with its numbers, and for one lane
CALLING = HEAD + "static INLINED void {name_of_one}({of_one})\n{{\n    {name}(1, {passed});\n}}\n"
CALL = re.compile(r"plant_(\w+)\((.*)\)$")
_VARIABLE = re.compile(r"\bv\d+\b")


@dataclass(frozen=True)
class Strided:
    """A vector argument: its name, its components' names on the tape, and the C text of its stride."""

    name: str
    components: Sequence[str]
    stride: str = "lanes"

    def at(self, k: int) -> str:
        """The text of component k."""
        return f"{self.name}[{k} * {self.stride}]" if self.stride != "1" else f"{self.name}[{k}]"

    @property
    def texts(self) -> dict[str, str]:
        """The text of each component."""
        return {component: self.at(k) for k, component in enumerate(self.components)}


def vector(name: str, size: int, stride: str = "lanes", prefix: str | None = None) -> Strided:
    """A vector argument whose components are called prefix0, prefix1, …, by default after its name."""
    return Strided(name, [f"{name if prefix is None else prefix}{k}" for k in range(size)], stride)


class Formulas:
    """A trace, and C functions of its formulas; `{name}` stands for the name of each."""

    def __init__(self, plant: Any, called: Collection[str] | None = None) -> None:
        """Of `called` the functions are not written out; by default of those whose programs are long."""
        self.plant = plant
        self.trace = Trace(plant, called_functions.called(plant) if called is None else called)

    def function(
        self, outputs: Any, arguments: Iterable[Strided | str], results: Mapping[str, int], stride: str = "lanes"
    ) -> str:
        """The C function of some outputs; see `function`."""
        n, m = self.plant.n, self.plant.m
        sizes = {name: n * getattr(step, "whole", 1) for name, step in self.trace.steps.items()}
        sizes |= {f"{d}{name}": one.size for name, one in self.trace.tape.networks.items() for d in ("", "d")}
        sizes = {"f": n, "df": n, "kappa": m, "law": 2 * m} | sizes
        return function("{name}", outputs, arguments, results, len(self.plant.p_names), stride, sizes)

    def f(self) -> str:
        """f of x, u with the stride of lanes, to y next to each other."""
        n, m = self.plant.n, self.plant.m
        y = self.trace.f(self.trace.vector("x", n), self.trace.vector("u", m), self.trace.input("t"))
        return self.function(y, [vector("x", n), vector("u", m), "t"], {"y": n}, "one")

    def called(self) -> list[str]:
        """The functions that those of this trace call."""
        texts, networks = [], self.trace.tape.networks
        for name in self.trace.tape.called():
            if name.removeprefix("d") in networks:
                texts += network.texts(networks[name.removeprefix("d")], name)
                continue
            arguments, outputs = called_functions.program(self.plant, name, self.trace.steps.get(name))
            read = {argument: f"q[{k}][l]" for k, argument in enumerate(arguments)}
            targets = [f"y[{k}][l]" for k in range(len(outputs))]
            lines = [statement(line) for line in programs.lines(np.ravel(outputs), read, targets, TEXTS)]
            texts.append(CALLED.format(name=name, lines="\n    ".join([LOOP, *(f"    {line}" for line in lines), "}"])))
        return texts


def function(
    name: str, outputs: Vector, arguments: Iterable[Strided | str], results: Mapping[str, int], p: int,
    stride: str = "lanes", sizes: Mapping[str, int] = {},
) -> str:  # fmt: skip
    """The C function `name` of vectors and numbers, then of the parameters p and of the `results`.

    The outputs are written to the results, arrays by name of so many components with that stride, in their order; what
    is written may be what was read. `sizes` are the results of the functions that it calls.
    """
    arguments = list(arguments)
    bindings = {f"p{k}": f"p[{k}]" for k in range(p)}
    for argument in arguments:
        bindings |= argument.texts if isinstance(argument, Strided) else {}
    targets = [Strided(result, [], stride).at(k) for result, size in results.items() for k in range(size)]
    strides = dict.fromkeys(a.stride for a in arguments if isinstance(a, Strided))
    strides |= {stride: None} if results else {}
    sized = [text for text in strides if text != "1"]
    tail = ["const double *p", *(f"double *{result}" for result in results)]
    heads = [f"const double *{a.name}" if isinstance(a, Strided) else f"double {a}" for a in arguments]
    named = ", ".join([*(f"const int {text}" for text in sized), *heads, *tail])
    program = programs.lines(outputs, bindings, targets, TEXTS)
    if not any(CALL.search(line) for line in program):
        lines = [statement(line) for line in program]
        return HEAD.format(name=name, arguments=named, lines="\n    ".join([*unused(named, lines), *lines]))
    for a in arguments:  # numbers are arrays then, too
        bindings |= {k: _at_lane(text, a.stride) for k, text in a.texts.items()} if isinstance(a, Strided) else {}
        bindings |= {} if isinstance(a, Strided) else {a: f"{a}[l]"}
    targets = [_at_lane(target, stride) for target in targets]
    lines = grouped(programs.lines(outputs, bindings, targets, TEXTS), sizes, statement)
    heads = [f"const double *{a.name if isinstance(a, Strided) else a}" for a in arguments]
    of_lanes = ", ".join(["const int count", *(f"const int {text}" for text in sized), *heads, *tail])
    passed = [*sized, *(a.name if isinstance(a, Strided) else f"&{a}" for a in arguments), "p", *results]
    return CALLING.format(
        name=f"{name}_of", arguments=of_lanes, lines="\n    ".join([*unused(of_lanes, lines), *lines]),
        name_of_one=name, of_one=named, passed=", ".join(passed),
    )  # fmt: skip


def _at_lane(text: str, stride: str) -> str:
    """The text of a component for lane l; with the stride 1 there is one lane."""
    return text if stride == "1" else f"{text[:-1]} + l]"


def unused(arguments: str, lines: Sequence[str]) -> list[str]:
    """The statements that say which of the declared arguments the lines do not read."""
    read = set(re.findall(r"\w+", "\n".join(lines)))
    names = [argument.rpartition(" ")[2].removeprefix("*") for argument in arguments.split(", ")]
    return [f"(void)({name});" for name in names if name not in read]


def grouped(program: Sequence[str], sizes: Mapping[str, int], statement: Callable[[str], str]) -> list[str]:
    """The lines of such a function: loops over lanes with the calls between them.

    `sizes` are the results of the functions that are called, `statement` the C of one line.
    """
    segments: list[tuple[list[str], str]] = [([], "")]  # the lines up to each call, and the call; the last has none
    for line in program:
        if CALL.search(line):
            segments[-1] = segments[-1][0], line
            segments.append(([], ""))
        else:
            segments[-1][0].append(line)
    arrays: set[str] = set()
    for k, (lines, _) in enumerate(segments):
        assigned = {line.partition(" = ")[0] for line in lines}
        later = {v for others, call in segments[k + 1 :] for line in (*others, call) for v in _VARIABLE.findall(line)}
        arrays |= assigned & later
    results = {call.partition(" = ")[0]: CALL.search(call)[1] for _, call in segments if call}  # type: ignore[index]
    in_order = sorted(arrays, key=lambda v: int(v[1:]))
    declared = [f"double {', '.join(f'{v}[GROUP]' for v in in_order)};"] if arrays else []
    declared += [f"double {v}[{sizes[name]}][GROUP];" for v, name in results.items()]
    lines = []
    for k, (glue, call) in enumerate(segments):
        inner = [_of_lane(statement(line), arrays, results) for line in glue]
        after = []
        if call:
            name, arguments = CALL.search(call).groups()  # type: ignore[union-attr]
            passed = arguments.split(", ")
            declared.append(f"double q{k}[{len(passed)}][GROUP];")
            inner += [f"q{k}[{i}][l] = {_of_lane(a, arrays, results)};" for i, a in enumerate(passed)]
            after = [f"CALLED(plant_{name}, count, q{k}, {call.partition(' = ')[0]});"]
        lines += [LOOP, *(f"    {line}" for line in inner), "}", *after]
    return declared + lines


def _of_lane(text: str, arrays: set[str], results: Mapping[str, str]) -> str:
    """The text for lane l: variables that are arrays get its index, and one that is assigned is not declared."""

    def indexed(match: re.Match[str]) -> str:
        v, item = match.group("v"), match.group("item") or ""
        return f"{v}{item}[l]" if v in arrays or v in results else match[0]

    text = re.sub(r"\b(?P<v>v\d+)\b(?P<item>\[\d+\])?", indexed, text)
    return re.sub(r"\bconst (?:int|double) (v\d+\[l\] =)", r"\1", text)
