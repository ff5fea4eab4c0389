"""Lines of C that set what no line reads."""

import re

WRITES = re.compile(r"\s*(?P<kind>(?:const )?(?:int|float|double|int32_t|int64_t) )?(?:memory->)?(?P<name>\w+)"
                    r"(?:\[[^;=]*\])? [-+*/]?= [^;]*;")  # fmt: skip


def written(line: str) -> str:
    """The variable that a line sets and does not read; empty for other lines."""
    match = WRITES.fullmatch(line)
    name = match["name"] if match else ""
    return name if name and len(re.findall(rf"\b{name}\b", line)) == 1 else ""


def declared(line: str) -> str:
    """The variable that a declaration is of."""
    return re.split(r"\W+", line)[1]


def only_written(lines: list[str], names: set[str]) -> set[str]:
    """Of these variables, and of those that are declared in the lines, the ones that no line reads."""
    names = names | {written(line) for line in lines if (match := WRITES.fullmatch(line)) and match["kind"]}
    read: set[str] = set()
    for line in lines:
        read |= set(re.findall(r"\w+", line)) - {written(line)}
    return names - read - {""}
