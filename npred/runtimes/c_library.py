"""A generated C file as a library that Python calls: to compare what it computes with what it should."""

import ctypes
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from npred.errors import NpredError
from npred.kernels.compiler import found
from npred.plants.base import Plant
from npred.runtimes.probe import Probe

FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC")


def compiler() -> tuple[str, ...] | None:
    """The C compiler of this machine, as the words of a command, or None."""
    return found() or None


def build(sources: Iterable[Path], target: Path, what: str, *flags: str) -> None:
    """Compile C sources into a shared library. Raises NpredError, in one line, where they do not compile."""
    command = [*(compiler() or ("cc",)), *FLAGS, *flags, *map(str, sources), "-o", str(target), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    if done.returncode:
        complaint = (done.stderr.splitlines() or ["no word"])[0]
        raise NpredError(f"export {what}: expected sources that compile, got: {complaint}; report it")


def outputs(path: Path, plant: Plant, nx: int, probe: Probe) -> tuple[np.ndarray, np.ndarray]:
    """P (B, nx, n) and U (B, m) of the C file for some samples. Raises NpredError where it does not compile."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "library.so"
        build([path], target, "c")
        library = ctypes.CDLL(str(target))
        rows = [_row(library, plant, nx, *row) for row in zip(*probe, strict=True)]
    P, U = (np.array(column) for column in zip(*rows, strict=True))
    return P, U


def _row(
    library: ctypes.CDLL, plant: Plant, nx: int, X: np.ndarray, u: np.ndarray, D_hat: float, t: float
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    P, U = np.empty((nx, plant.n)), np.empty(plant.m)
    X, u = np.array(X, dtype=float), np.array(u, dtype=float, order="C")
    delay, now, arrives = (ctypes.c_double(value) for value in (D_hat, t, t + D_hat))
    library.npred_predict(_address(X), _address(u), delay, *([now] if plant.phased else []), _address(P))
    if plant.one_delay:
        library.npred_control(_address(P[-1]), arrives, _address(U))
    else:
        library.npred_control(_address(P), delay, now, _address(U))
    return P, U


def _address(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
