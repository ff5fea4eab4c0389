"""C to a shared library that this process calls: compiled once per text, flags, compiler and processor, and kept.

The compiler is cc, gcc or clang, else that of the package ziglang. Another process may be faster: npred.kernels.cache.
"""

import ctypes
import hashlib
import shutil
import subprocess
import sys
import threading
from collections import defaultdict
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from npred.errors import MissingError, NpredError
from npred.kernels import cache as disk

COMPILERS = ("cc", "gcc", "clang")
# Contraction, the sign of zero and reciprocals may change the last digit; NaN and infinities stay what they are, since
# a rollout that diverged must stay visible as such.
FLAGS = (
    "-std=c99", "-O3", "-march=native", "-fPIC", "-shared", "-ffp-contract=fast", "-fno-signed-zeros",
    "-freciprocal-math", "-fno-trapping-math", "-fno-math-errno", "-fno-strict-aliasing", "-Wall", "-Wextra",
    "-Wno-unused-parameter", "-Wno-unused-function", "-Wno-unknown-pragmas",
)  # fmt: skip
LIMIT = 1200.0  # s that a compiler may take
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


def library(text: str) -> ctypes.CDLL:
    """The library of a C text. Raises NpredError where it does not compile, or where the disk is full."""
    name = _named(text)
    with _locks[name]:
        if name not in _loaded:
            _loaded[name] = ctypes.CDLL(str(_kept(name, text) / LIBRARY))
        return _loaded[name]


def _kept(name: str, text: str) -> Path:
    """The folder of a library, sound, made if it has to be."""
    target = disk.root() / name
    if disk.sound(target):
        return target
    aside = disk.aside()
    try:
        (aside / TEXT).write_text(text, encoding="utf-8")
        _compile(aside)
        disk.install(aside, target)
    except OSError as error:
        raise disk.full(error, disk.root()) or error from None
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return target


def _compile(folder: Path) -> None:
    asked = [*command(), *FLAGS, TEXT, "-o", LIBRARY, "-lm"]
    done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, timeout=LIMIT)
    if done.returncode:
        complaint = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
        raise NpredError(f"{asked[0]}: expected a kernel that compiles, got: {complaint}; report it")


def _named(text: str) -> str:
    """npred_<digest> of all that a library depends on."""
    return "npred_" + hashlib.sha256("\n".join([*_machine(), text]).encode()).hexdigest()[:32]


@cache
def version() -> str | None:
    """What the compiler says that it is; None where there is none."""
    if not (words := found()):
        return None
    return subprocess.run([*words, "--version"], capture_output=True, text=True, timeout=60).stdout.partition("\n")[0]


@cache
def _machine() -> tuple[str, ...]:
    """The compiler, its flags and the processor."""
    return (*command(), version() or "", *FLAGS, *_processor())


def _processor() -> list[str]:
    """What -march=native depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    kinds = ("model name", "flags", "Features", "CPU part")
    return sorted({line for line in lines if line.startswith(kinds)})
