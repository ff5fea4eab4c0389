"""C to a shared library that this process calls: compiled once per text, flags, compiler and processor, and kept.

The compiler is cc, gcc or clang, else that of the package ziglang. Another process may be faster: npred.kernels.cache.
"""

import ctypes
import hashlib
import re
import shutil
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from npred.base import progress
from npred.base.errors import MissingError, NpredError, disk_is_full, first_line
from npred.kernels import cache as disk

COMPILERS = ("cc", "gcc", "clang")
# Contraction, the sign of zero and reciprocals may change the last digit; NaN and infinities stay what they are, since
# a rollout that diverged must stay visible as such.
FLAGS = (
    "-std=c99", "-O3", "-march=native", "-fPIC", "-shared", "-ffp-contract=fast", "-fno-signed-zeros",
    "-freciprocal-math", "-fno-trapping-math", "-fno-math-errno", "-fno-strict-aliasing", "-Wall", "-Wextra",
    "-Wno-unused-parameter", "-Wno-unused-function", "-Wno-unknown-pragmas",
)  # fmt: skip
# Flags for kernels of a controller: each operation rounds by itself, as in C99, so that its export computes the same.
EXACT = ("-ffp-contract=off", "-fno-reciprocal-math", "-fsigned-zeros")
LIMIT = 1200.0  # s that a compiler may take
SIDE_BY_SIDE = 2  # compilers at once
START, SPEED = 0.1, 2e5  # s that a compiler takes at least, and characters of formulas that it reads in one more
STANDARD = ("-lm",)
ALONE, ONCE = "compiling a kernel", "once per plant or network on this machine"
LIBRARY, TEXT = "kernel.so", "kernel.c"
_locks: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)  # one writer per library
_loaded: dict[str, ctypes.CDLL] = {}


def found() -> tuple[str, ...]:
    """The C compiler of this machine, as the words of a command; none where there is none."""
    paths = filter(None, map(shutil.which, COMPILERS))
    return tuple(list(paths)[:1]) or ((sys.executable, "-m", "ziglang", "cc") if find_spec("ziglang") else ())


@cache
def command() -> tuple[str, ...]:
    """The same. Raises MissingError where there is none."""
    if not (words := found()):
        cure = "install gcc or clang, or pip install ziglang"
        raise MissingError(f"C compiler: expected {', '.join(COMPILERS)} on the PATH, found none; {cure}")
    return words


def library(text: str, exact: bool = False) -> ctypes.CDLL:
    """The library of a C text, with EXACT or not. Raises NpredError where it does not compile, or the disk is full."""
    flags = (*FLAGS, *EXACT) if exact else FLAGS
    name = _named(text, flags)
    with _locks[name]:
        if name in _loaded:
            return _loaded[name]
        target = disk.root() / name
        if not disk.sound(target):
            aside = disk.aside()
            try:
                (aside / TEXT).write_text(text, encoding="utf-8")
                with progress.announce(ALONE, _seconds([text]), ONCE):
                    _compile(aside, flags)
                disk.install(aside, target)
            except OSError as error:
                raise disk.full(error, disk.root()) or error from None
            finally:
                shutil.rmtree(aside, ignore_errors=True)
        _loaded[name] = ctypes.CDLL(str(target / LIBRARY))
        return _loaded[name]


def prepare(texts: Iterable[str], exact: bool = False) -> None:
    """Compile the texts that are not there yet, side by side: a first loop needs five. Raises as `library` does."""
    flags = (*FLAGS, *EXACT) if exact else FLAGS
    named = {_named(text, flags): text for text in texts}
    missing = [text for name, text in named.items() if name not in _loaded and not (disk.root() / name).exists()]

    def compile_silently(text: str) -> None:
        with progress.quiet():
            library(text, exact)

    doing = f"compiling {len(missing)} kernels" if len(missing) > 1 else ALONE
    with progress.announce(doing, _seconds(missing), ONCE), ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        list(pool.map(compile_silently, sorted(missing, key=len, reverse=True)))


def _seconds(texts: Iterable[str]) -> float:
    """About how long texts take: the numbers of a network, which are most of its text, take none."""
    lines = [sum(map(len, re.findall(r"^.*;$", text, re.MULTILINE))) for text in texts]
    return (START * len(lines) + sum(lines) / SPEED) / min(SIDE_BY_SIDE, max(len(lines), 1))


def _compile(folder: Path, flags: tuple[str, ...]) -> None:
    asked = [*command(), *flags, TEXT, "-o", LIBRARY]

    def run(libraries: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
        words = [*asked, *libraries]
        return subprocess.run(words, cwd=folder, capture_output=True, encoding="utf-8", errors="replace", timeout=LIMIT)

    done = run(_libraries())
    if done.returncode and _libraries() != STANDARD:
        done = run(STANDARD)
    if done.returncode:
        full = disk_is_full(OSError(done.stderr))
        todo = f"free some of the disk, or name others in {disk.VARIABLE} and TMPDIR" if full else "report it"
        raise NpredError(f"{asked[0]}: expected a kernel that compiles, got: {complaint(done)}; {todo}")


def complaint(done: subprocess.CompletedProcess[str]) -> str:
    """The complaint of a compiler that failed: its first line with an error, else its first one, else how it ended."""
    lines = [line for line in done.stderr.splitlines() if "error" in line]
    return first_line("\n".join(lines) or done.stderr, f"no word, exit code {done.returncode}")


@cache
def _libraries() -> tuple[str, ...]:
    """The libraries of a kernel: for ziglang those of this process, for its own take six seconds to compile."""
    maps = Path("/proc/self/maps")
    if "ziglang" not in command() or not maps.exists():
        return STANDARD
    mapped = {line.split()[-1] for line in maps.read_text(encoding="utf-8", errors="replace").splitlines()}
    loaded = sorted(path for path in mapped if re.search(r"/lib[cm]\.so\.6$", path))
    return ("-nostdlib", "-Wl,-z,defs", *loaded) if len(loaded) == len("cm") else STANDARD


def _named(text: str, flags: tuple[str, ...]) -> str:
    """npred_<digest> of all that a library depends on."""
    return "npred_" + hashlib.sha256("\n".join([*_machine(), *flags, text]).encode()).hexdigest()[:32]


@cache
def version() -> str | None:
    """The first line of the compiler's `--version`; None where there is no compiler."""
    if not (words := found()):
        return None
    said = subprocess.run([*words, "--version"], capture_output=True, text=True, timeout=60).stdout
    return first_line(said, "no version")


@cache
def _machine() -> tuple[str, ...]:
    """The compiler, and the lines about the processor that -march=native depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    kinds = ("model name", "flags", "Features", "CPU part")
    return (*command(), version() or "", *sorted({line for line in lines if line.startswith(kinds)}))
