"""Controllers exported to C, compiled with gcc and called by ctypes, and closed loops of either kind of controller."""

import ctypes
import functools
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from npred.exports import c_controller
from npred.loop import engine
from npred.loop.actuator import actuate, history, transport
from npred.loop.status import Status
from npred.plants.inputs import Past
from npred.prediction.methods import RK4

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
LANE_BY_LANE = """
static inline void KERNEL(Shape d, const double *X, double t, double *U, double *work)
{
    const double p[1] = {0.0};
    (void)t, (void)work;
    for (int l = 0; l < d.lanes; l++) {
        F(d.lanes, X + l, p, U + l);
    }
}
"""  # a kernel of one formula F
FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror"]
SIZES = """
#include "npred.c"
unsigned long size_of_controller(void);
unsigned long size_of_saved(void);
unsigned long size_of_controller(void) { return sizeof(npred_controller); }
unsigned long size_of_saved(void) { return sizeof(npred_saved); }
"""
TYPES = {"double": np.float64, "float": np.float32}
COMPILED = {}  # libraries by their text: tests of one controller share one
sources = functools.cache(c_controller.sources)


def compilers():
    """The C compilers of this machine, as the words of commands by their names: gcc, clang, the newest clang-N, zig."""
    found = {name: (name,) for name in ("gcc", "clang") if shutil.which(name)}
    files = [path for folder in os.get_exec_path() for path in Path(folder).glob("clang-*")]
    numbered = [path for path in files if re.fullmatch(r"clang-\d+", path.name)]
    if numbered:
        newest = max(numbered, key=lambda path: int(path.name.removeprefix("clang-")))
        if "clang" not in found or Path(shutil.which("clang")).resolve() != newest.resolve():
            found[newest.name] = (str(newest),)
    return found | ({"zig": (sys.executable, "-m", "ziglang", "cc")} if find_spec("ziglang") else {})


COMPILERS = compilers()


def find_nothing(folder, file, *flags, names=("gcc", "clang")):
    """A test fails for a warning that one of these compilers, where it is there, has for a C file."""
    for name in filter(COMPILERS.get, names):
        only = ["-c", "-o", "found_nothing.o"] if name == "zig" else ["-fsyntax-only"]  # which zig does not know
        command = [*COMPILERS[name], *flags, "-Werror", *only, file]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0 and not done.stderr, f"{name}: {done.stderr}"


def library(controller, folder, precision="double", more=()):
    """The shared library of a controller, with more flags of gcc; its two files are in the folder."""
    header, source = sources(controller, precision=precision)
    (folder / "npred.h").write_text(header)
    (folder / "npred.c").write_text(source)
    (folder / "sizes.c").write_text(SIZES)
    if (header, source, more) in COMPILED:
        return COMPILED[header, source, more]
    flags = [*FLAGS, *more, *(["-Wdouble-promotion"] if precision == "float" else [])]
    find_nothing(folder, "sizes.c", *flags, names=("clang",))  # gcc compiles it with these flags
    command = ["gcc", *flags, "-shared", "-fPIC", "sizes.c", "-o", "npred.so", "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    return COMPILED.setdefault((header, source, more), ctypes.CDLL(str(folder / "npred.so")))


class InC:
    """One controller of a library, with the calls of npred.controller."""

    def __init__(self, compiled, plant, precision="double"):
        compiled.size_of_controller.restype = compiled.size_of_saved.restype = ctypes.c_ulong
        self.library, self.type, self.m = compiled, TYPES[precision], plant.m
        self.memory = ctypes.create_string_buffer(compiled.size_of_controller())
        compiled.npred_init(self.memory)

    def step(self, X, *measured):
        """U; an assertion fails for a return code that is not 0."""
        U = np.full(self.m, np.nan, self.type)
        assert self.code(X, *measured, out=U) == 0
        return U

    def code(self, X, *measured, out=None):
        arrays = [np.ascontiguousarray(a, dtype=self.type) for a in (X, *measured)]
        U = np.full(self.m, np.nan, self.type) if out is None else out
        function = self.library.npred_step_nodes if len(measured) == 2 else self.library.npred_step
        return function(self.memory, *(a.ctypes.data_as(ctypes.c_void_p) for a in (*arrays, U)))

    def step_at(self, t, X=None, sampled_at=0.0):
        """The code of a call, and U, NaN where it was refused."""
        U = np.full(self.m, np.nan, self.type)
        X = None if X is None else np.ascontiguousarray(X, dtype=self.type)
        sample = None if X is None else X.ctypes.data_as(ctypes.c_void_p)
        times = ctypes.c_double(t), sample, ctypes.c_double(sampled_at)
        return self.library.npred_step_at(self.memory, *times, U.ctypes.data_as(ctypes.c_void_p)), U

    def applied(self, U):
        return self.library.npred_applied(self.memory, np.array(U, self.type).ctypes.data_as(ctypes.c_void_p))

    def set_time(self, t):
        return self.library.npred_set_time(self.memory, ctypes.c_double(t))

    def status(self, outputs):
        """npred_get_status as Python's, with so many outputs."""
        real = ctypes.c_double if self.type is np.float64 else ctypes.c_float
        reals, counts = ("D_hat", "D_hat_spread", "error"), ("late", "refused", "missed", "renewed", "handed_over")
        arrays = [("innovation", real * outputs), ("offset", real * self.m)]
        fields = [*((name, real) for name in reals), ("age", ctypes.c_double), *arrays]
        counts = (*counts, "fallback", "filtered", "unkept", "promised", "withdrawn", "at_bound")
        fields += [(name, ctypes.c_int32) for name in counts] + [("kept", real)]
        status = type("Fields", (ctypes.Structure,), {"_fields_": fields})()
        self.library.npred_get_status(self.memory, ctypes.byref(status))
        return Status(**{name: getattr(status, name) for name in Status._fields})

    def state(self):
        saved = ctypes.create_string_buffer(self.library.size_of_saved())
        self.library.npred_get_state(self.memory, saved)
        return saved

    def restore(self, saved):
        return self.library.npred_set_state(self.memory, saved)


def closed_loop(controller, plant, D, dt, steps, X0, measured, nx=0, again=4000):
    """X (steps, n) and U (steps, m) of a loop whose state is set back every `again` steps."""
    advance, X, p = engine.advance_kernel(plant, RK4), np.array(X0, dtype=float)[:, None], plant.p
    longest = np.array([D if np.isscalar(D) else 3.0])
    k, held, total = history(longest[0], longest[0], dt, Past(np.zeros((1, plant.m))))
    delays = (plant.ratios * longest)[:, None]
    u, u_nodes = np.zeros((nx or 2, plant.m, 1)), np.zeros((nx or 2, plant.m, 1))
    U0, U1, share = (np.zeros((plant.m, 1)) for _ in range(3))
    states, commands = np.empty((steps, plant.n)), np.empty((steps, plant.m))
    for step in range(steps):
        if step % again == 0:
            X[:, 0] = X0
        states[step] = X[:, 0]
        if not np.isscalar(D):
            delays[:] = D(X[:, 0], step * dt)
        if measured:
            transport(k, dt, delays, held, total, u, u_nodes)
            commands[step] = controller.step(X[:, 0], u[:, :, 0], u_nodes[:, :, 0])
        else:
            commands[step] = controller.step(X[:, 0])
        actuate(k, dt, delays, commands[step][:, None].copy(), held, total, U0, U1, share)
        k += 1
        advance(X, U0, U1, share, dt, step * dt, p)
    return states, commands


def differ(a, b):
    """The largest difference of each column, relative to the column's largest value."""
    return (np.abs(a - b).max(axis=0) / np.abs(a).max(axis=0)).max()
