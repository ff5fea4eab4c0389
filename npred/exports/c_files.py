"""The C files that an export writes, from skeletons in C99, and the libraries that a compiler makes of them."""

import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from npred.base.errors import NpredError, required
from npred.kernels.compiler import complaint, found

FOLDER = Path(__file__).parent / "c"
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
_NAMED = re.compile(r"\b(npred|NPRED)(?=[_.])")


def filled(
    file: str,
    name: str = "npred",
    real: str = "double",
    variants: Mapping[str, bool] = {},
    included: Mapping[str, str] = {},
) -> str:
    """The text of a file of npred/exports/c.

    Its variants, `#if NAME`, are decided; npred_real is `real`; other words that begin with npred_ or NPRED_ begin with
    `name`; for a line `#include "NAME.h"` comes the text that `included` has by that name. Other conditions and
    includes stay for the compiler.
    """
    text = decided((FOLDER / file).read_text(encoding="utf-8"), variants)
    text = re.sub(r"\bnpred_real\b", real, text)
    text = _NAMED.sub(lambda word: name if word[1].islower() else name.upper(), text)
    return re.sub(r'^#include "(\w+)\.h"$', lambda line: included.get(line[1], line[0]), text, flags=re.MULTILINE)


def decided(text: str, variants: Mapping[str, bool]) -> str:
    """The text without the branches `#if NAME`, `#else` that do not hold, and without the lines of these conditions."""
    lines: list[str] = []
    around: list[bool | None] = []  # whether each condition around a line holds; None: the compiler decides it
    for line in text.splitlines():
        word, _, condition = line.partition(" ")
        if word.startswith("#if"):
            around.append(variants.get(condition) if word == "#if" else None)
        elif word == "#else" and around[-1] is not None:
            around[-1] = not around[-1]
        directs = word.startswith(("#if", "#else", "#endif")) and around[-1] is not None
        if not directs and False not in around:
            lines.append(line)
        if word.startswith("#endif"):
            around.pop()
    return "\n".join(lines) + "\n"


def compiler() -> tuple[str, ...] | None:
    """The C compiler of this machine, as the words of a command, or None."""
    return found() or None


def build(sources: Iterable[Path], target: Path, what: str, *flags: str, other: str = "") -> None:
    """Compile C sources into a shared library, for this machine or for an `other`, as zig names it.

    Raises NpredError, in one line, where they do not compile, MissingError for another machine without ziglang.
    """
    words = compiler() or ("cc",)
    if other:
        required(f"export {what}", "ziglang", "ziglang", "zig")
        words = sys.executable, "-m", "ziglang", "cc", "-target", other
    command = [*words, *FLAGS, *flags, *map(str, sources), "-o", str(target), "-lm"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", timeout=600)
    if done.returncode:
        raise NpredError(f"export {what}: expected sources that compile, got: {complaint(done)}; report it")
