"""Run every command that a page names, and compare what it prints with the page's figures.

    python benchmarks/pages.py [PAGES] [--list] [--only PATTERN] [--longest 600]

Commands are the lines of blocks marked `sh` and the words in backticks that begin with `npred `, `make `, `python
benchmarks/` or `python tests/`. Left out are those with an argument in capital letters, names of a command without one,
and those that install, delete, or need a cluster. Each runs once, in a copy of the repository's files and those of the
page, with the store NPRED_STORE or artifacts/. The figures of a command are the numbers with a decimal point or an
exponent in its paragraph, list item or table row, and in what follows before the next command or heading. Each is
looked for in what is printed:

    reprinted    a number that rounds to it, or 100 times that number does, as of 0.012 for 1.2 %; for a timing (behind
                 it a unit as µs, ms, min, MB, or x) one within 25 %
    differs      the nearest printed number is within a factor of 2
    not printed  none is

It exits with 1 where a figure differs, and where a command fails or takes too long. Figures of other machines may
differ by right: a reader decides. It is run before each release.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from harness import ROOT, options

BEGINS = ("npred ", "python benchmarks/", "python tests/", "make ")
INLINE = re.compile(rf"`((?:{'|'.join(BEGINS)})[^`]*)`")
LEFT = re.compile(r"make (-C \S+ )?(all|install|dev|clean|constraints|test|docs|check)\b|npred gc|.*dask:")
OPEN = re.compile(r"(?<![\w.:-])[A-Z][A-Z_]+(?![\w=.])|…|\.\.\.")  # an argument that the reader fills in
NUMBER = re.compile(r"(?<![\w.,])[-−+]?(?:\d+\.?\d*|\.\d+)(?:e[-−+]?\d+)?", re.IGNORECASE)
TIMING = re.compile(r"\s*(?:\|?\s*)?(?:ns|µs|us|ms|min|minutes|seconds|hours|kB|MB|GB|x\b|times\b|%? of the time)")
FILE = re.compile(r"^```\w*\n(# (\w+\.(?:py|toml))\n.*?)^```", re.MULTILINE | re.DOTALL)  # a block that is a file
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
WORTH = re.compile(r"[.e]", re.IGNORECASE)  # whole numbers stand everywhere: settings, counts, equations


class Named(NamedTuple):
    """Commands of a page, the line, and the page's figures beside them, each with whether it is a timing."""

    line: int
    commands: list[str]
    figures: list[tuple[str, bool]]


def blocks(text: str) -> Iterator[tuple[int, str]]:
    """Paragraphs, list items, tables or their rows with commands, and fenced blocks of a page, each with its line."""
    lines, start, fenced = text.splitlines(), 0, False
    for i, line in enumerate([*lines, ""]):
        begins = not line.strip() or re.match(r"(```|#|[-*] |\d+\. )", line) or (line[0] == "|" and INLINE.search(line))
        if not fenced and begins and i > start:
            yield start + 1, "\n".join(lines[start:i])
            start = i
        if line.startswith("```"):
            fenced = not fenced
            if not fenced:
                yield start + 1, "\n".join(lines[start : i + 1])
                start = i + 1


def commands(block: str) -> list[str]:
    """The commands of a block, without comments, that can be run as they stand."""
    fence = re.match(r"```(\w*)\n", block)
    if fence:
        lines = block.replace("\\\n", " ").splitlines()[1:-1] if fence[1] == "sh" else []
        found = [line.partition(" #")[0].strip() for line in lines if line.startswith(BEGINS)]
    else:
        found = [" ".join(words.split()) for words in INLINE.findall(block)]
        found = [words for words in found if words[:6] != "npred " or re.search(r"[-./:_\d]", words)]
    return [words for words in found if not OPEN.search(words) and not LEFT.match(words)]


def level(text: str) -> str:
    """A text with 3.4e-3 for 3.4·10⁻³."""
    return re.sub(r"·10([⁻⁰¹²³⁴-⁹]+)", lambda power: "e" + power[1].translate(RAISED), text)


def figures(block: str) -> list[tuple[str, bool]]:
    """The numbers of a block, outside commands, links and code of other languages, with whether they are timings."""
    if re.match(r"```(?!text|console)", block):
        return []
    block = re.sub(r"^```.*$", "", block, flags=re.MULTILINE)
    plain = re.sub(r"\]\([^)]*\)|https?:\S+|arXiv:\S+", "]", re.sub(r"`[^`]*`", "`", level(block).replace("**", "")))
    found = [(each[0], bool(TIMING.match(plain, each.end()))) for each in NUMBER.finditer(plain)]
    return [(word, timing) for word, timing in found if WORTH.search(word.rstrip("."))]


def named(text: str) -> Iterator[Named]:
    """The commands of a page's text. Blocks without one belong to the last, until a heading."""
    last: Named | None = None
    for line, block in [*blocks(text), (0, "#")]:
        found = commands(block)
        if last and (found or block.startswith("#")):
            yield last
            last = None
        if found:
            last = Named(line, found, [])
        if last:
            last.figures.extend(figures(block))


def value(word: str) -> float:
    return float(word.replace("−", "-"))


def verdict(word: str, timing: bool, printed: list[float]) -> str:
    """Whether a figure is among the printed ones: signs are the page's own affair, 0.012 may stand as 1.2 %."""
    mantissa, _, power = word.lower().replace("−", "-").partition("e")
    last = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    wanted = abs(value(word))
    near = [abs(abs(each) * scale - wanted) for each in printed for scale in (1, 100)]
    allowed = wanted / 4 if timing else last / 2 + 1e-9 * wanted
    least = min(near, default=float("inf"))
    return "reprinted" if least <= allowed else "differs" if least <= wanted / 2 else "not printed"


def run(command: str, folder: Path, longest: float) -> tuple[int, str]:
    """Exit code (124: too long) and what a command printed."""
    words = shlex.split(command)
    words[:1] = {"python": [sys.executable], "npred": [sys.executable, "-m", "npred"]}.get(words[0], words[:1])
    settings = {"NPRED_STORE": str(ROOT / "artifacts")} | os.environ | {"PYTHONPATH": str(folder), "COLUMNS": "200"}
    with tempfile.TemporaryFile("w+") as said:
        with subprocess.Popen(words, cwd=folder, env=settings, stdout=said, stderr=said, start_new_session=True) as job:
            try:
                code = job.wait(longest)
            except subprocess.TimeoutExpired:
                os.killpg(job.pid, signal.SIGKILL)  # the processes that it began, too
                code = 124
        said.seek(0)
        return code, said.read()


def copied(folder: Path) -> None:
    """The repository's files, without results and what is ignored."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)


def main() -> None:
    every = [ROOT / "README.md", ROOT / "benchmarks" / "README.md", *sorted((ROOT / "docs").glob("**/[a-z]*.md"))]
    asked = options(__doc__, {"pages": every}, list=False, only="", longest=600.0)
    outcomes, totals = dict[str, tuple[int, str]](), Counter[str]()
    with tempfile.TemporaryDirectory() as scratch:
        copied(Path(scratch))
        texts = {page: page.read_text(encoding="utf-8") for page in asked.pages}
        for path, each in [(page, group) for page, text in texts.items() for group in named(text)]:
            for text, name in FILE.findall(texts[path]):
                (Path(scratch) / name).write_text(text, encoding="utf-8")
            chosen = [command for command in each.commands if re.search(asked.only, command)]
            printed: list[float] = []
            for command in chosen:
                if not asked.list and command not in outcomes:
                    outcomes[command] = run(command, Path(scratch), asked.longest)
                code, text = outcomes.get(command, (0, ""))
                said = {0: "", 3: "", 124: "  TOO LONG"}.get(code, f"  FAILED with {code}: {text.strip()[-150:]!r}")
                print(f"{os.path.relpath(path, ROOT)}:{each.line}  {command}{said}", flush=True)
                totals["failed"] += code not in (0, 3)  # 3: an answer is no
                printed += [value(number) for number in NUMBER.findall(level(text))] if code in (0, 3) else []
            sides = [(verdict(*figure, printed), figure[0]) for figure in each.figures if printed]
            totals.update(side for side, _ in sides)
            for side in ("reprinted", "differs", "not printed"):
                if words := [word for found, word in sides if found == side]:
                    print(f"    {side:11s}  {' '.join(words)}", flush=True)
    print(", ".join(f"{count} {side}" for side, count in totals.items()))
    sys.exit(int(bool(totals["failed"] or totals["differs"])))


if __name__ == "__main__":
    main()
