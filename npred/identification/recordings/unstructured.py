"""Logs whose lines are no rows of a table: those of printers (Klipper, Marlin), and the traces of CODESYS.

Each function takes the lines of a file and gives columns by name, an empty table for a file of another kind.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any
from xml.etree import ElementTree

from npred.identification.recordings.table import pd

LEAST = 3  # lines by which a log is known
KLIPPER = re.compile(r"Stats (\d+\.\d+): (.*)")
HOST = {"gcodein", "sysload", "cputime", "memavail", "print_time", "buffer_time", "print_stall"}  # of no section
MARLIN = re.compile(r"(?:(\d{4}-\d\d-\d\d[ T][\d:.,]+|\d{1,2}:\d\d:\d\d[.,\d]*)\b)?.*?(?<!\S)(T\d?:\s*-?[\d.]+\s*/.*)")
HEATER = re.compile(r"([A-Z]?\d?@?\d?):\s*(-?[\d.]+)(?:\s*/\s*(-?[\d.]+))?")
VARIABLE = re.compile(r"\s*\d+\.Variable\s*;\s*([^;]+)")
SAMPLE = re.compile(r"\s*;\s*(-?\d+)\s*;\s*([^;\s]+)")
MICROSECONDS = re.compile(r'"MicroSeconds"[^>]*>\s*True|^\s*Flags\s*;\s*32\b', re.IGNORECASE | re.MULTILINE)


def columns(lines: Sequence[str]) -> Any:
    """The table of the first kind that the lines are of."""
    return next((table for kind in (klipper, marlin, codesys) if len(table := kind(lines))), pd.DataFrame())


def klipper(lines: Sequence[str]) -> Any:
    """Lines `Stats 12.3: gcodein=0 heater_bed: target=60 temp=59.9`: heater_bed.temp at 12.3 s."""
    rows = []
    for line in lines:
        if stats := KLIPPER.search(line):
            row, section = {"time [s]": stats[1]}, ""
            for word in stats[2].split():
                key, sign, value = word.partition("=")
                section = section if sign else f"{word.rstrip(':')}."
                row |= {key if key in HOST else f"{section}{key}": value} if sign else {}
            rows.append(row)
    return pd.DataFrame(rows if len(rows) >= LEAST else [])


def marlin(lines: Sequence[str]) -> Any:
    """Answers to M105, as `ok T:200.1 /210.0 B:60 /60 @:64 B@:9`: T, T.target, ..., with the stamps of a host."""
    answers = [match for line in lines if (match := MARLIN.match(line))]
    rows = []
    for match in answers if len(answers) >= LEAST else ():
        row = {"time": match[1]} if match[1] else {}
        for name, value, target in HEATER.findall(match[2]):
            row |= {name: value} | ({f"{name}.target": target} if target else {})
        rows.append(row)
    return pd.DataFrame(rows)


def codesys(lines: Sequence[str]) -> Any:
    """A trace as XML (.trace), or as CSV: a block for each variable. Samples of all variables at their joint times."""
    text = "\n".join(lines)
    starts = [k for k, line in enumerate(lines) if VARIABLE.match(line)]
    if "<TraceVariable" in text:
        variables = ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*>", "", text)).iter("TraceVariable")
        texts = [(v.get("VarName", ""), *(v.findtext(key, "").split(",") for key in ("Timestamps", "Values")))
                 for v in variables]  # fmt: skip
    else:
        blocks = [lines[k:end] for k, end in pairwise([*starts, len(lines)])]
        pairs = [[match.groups() for line in block if (match := SAMPLE.match(line))] for block in blocks]
        texts = [(VARIABLE.match(lines[k])[1].strip(), *zip(*rows, strict=True))  # type: ignore[index]
                 for k, rows in zip(starts, pairs, strict=True) if rows]  # fmt: skip
    series = [pd.Series(values, index=pd.to_numeric(pd.Series(stamps)), name=name) for name, stamps, values in texts]
    if not series:
        return pd.DataFrame()
    table = pd.concat([each[~each.index.duplicated(keep="last")] for each in series], axis=1).sort_index()
    return table.rename_axis("time [us]" if MICROSECONDS.search(text) else "time [ms]").reset_index()
