"""Functions that call a costly plant's own functions, for several lanes: loops over lanes between the calls.

Inlined in a loop over lanes, a call ends what a compiler makes of that loop. So the lanes of a GROUP go together from
one call to the next: what is needed later is an array with a number for each lane.
"""

import re
from collections.abc import Callable, Mapping, Sequence

CALL = re.compile(r"plant_(\w+)\((.*)\)$")
_VARIABLE = re.compile(r"\bv\d+\b")
LOOP = "LANES for (int l = 0; l < count; l++) {"
# `count` is one or GROUP, both compiled apart
CALLED = """static INLINED void plant_{name}_of(const int count, const double (*q)[GROUP], double (*y)[GROUP])
{{
    {loop}
        {lines}
    }}
}}
static APART void plant_{name}_one(const double (*q)[GROUP], double (*y)[GROUP])
{{
    plant_{name}_of(1, q, y);
}}
#if GROUP > 1
static APART void plant_{name}_group(const double (*q)[GROUP], double (*y)[GROUP])
{{
    plant_{name}_of(GROUP, q, y);
}}
#endif
"""


def called(name: str, lines: Sequence[str]) -> str:
    """The C of a function that is called, of statements that read q[k][l] and write y[k][l]."""
    return CALLED.format(name=name, loop=LOOP, lines="\n        ".join(lines))


def body(program: Sequence[str], sizes: Mapping[str, int], statement: Callable[[str], str]) -> list[str]:
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
    return re.sub(r"^const (?:int|double) (v\d+\[l\] =)", r"\1", text)
