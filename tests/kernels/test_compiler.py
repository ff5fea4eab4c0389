"""The compiler: threads that want the same library, texts that do not compile, machines without a compiler."""

import ctypes
import os
import re
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from c_controllers import COMPILERS, needs_gcc
from conftest import HERE

from npred.base.errors import MissingError, NpredError
from npred.exports import c_files
from npred.kernels import cache, compiler

# Of the size of a signal: what compilers may differ by, which contract other sums and products.
ROUNDED = {"Cart": 1e-9}  # has a filter, whose slopes are differences of rollouts: rounding errors over 1e-4
OTHERWISE = 1e-13
TEXT = "double twice(double a) {{ return {} * a; }}"


@pytest.fixture(autouse=True)
def empty_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "root", lambda: tmp_path)
    monkeypatch.setattr(compiler, "_loaded", {})


def twice(text, value):
    function = compiler.library(text).twice
    function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return function(value)


def test_threads_that_want_the_same_library_compile_it_once(tmp_path, monkeypatch):
    compiled, original = [], compiler._compile
    monkeypatch.setattr(compiler, "_compile", lambda *asked: (compiled.append(asked), original(*asked)))
    with ThreadPoolExecutor(8) as pool:
        assert [*pool.map(lambda _: twice(TEXT.format("2.0"), 21.0), range(8))] == [42.0] * 8
    assert len(compiled) == 1 and len([*tmp_path.iterdir()]) == 1


def test_another_text_is_another_library():
    assert [twice(TEXT.format(factor), 3.0) for factor in ("2.0", "5.0")] == [6.0, 15.0]


def test_an_exact_library_rounds_each_operation_by_itself():
    """1 + 2^-27 squared is 1 + 2^-26 + 2^-54, whose last term is lost in the product, and not in a multiply-add."""
    text = "double left(double a) { return a * a - 1.0; }\ndouble part(double a) { return a / 49.0; }"
    functions = compiler.library(text, exact=True)
    for function in (functions.left, functions.part):
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    assert functions.left(1 + 2.0**-27) == 2.0**-26
    assert [functions.part(float(a)) for a in range(99)] == [a / 49 for a in range(99)]
    assert compiler.library(text)._name != functions._name


def test_a_text_that_does_not_compile_is_told_in_one_line_and_not_kept(tmp_path):
    with pytest.raises(NpredError, match=r"expected a kernel that compiles, got: .*report it") as caught:
        compiler.library("double twice(double a) { return 2.0 * b; }")
    assert "\n" not in str(caught.value) and not [*tmp_path.iterdir()]


def test_a_compiler_that_writes_in_another_encoding_is_told_in_one_line_too(monkeypatch):
    complaint = (sys.executable, "-c", r"import sys; sys.stderr.buffer.write(b'error: d\xe9clar\x81'); sys.exit(1)")
    monkeypatch.setattr(compiler, "command", lambda: complaint)
    with pytest.raises(NpredError, match=r"got: error: d.clar.; report it"):
        compiler.library(TEXT.format("11.0"))


@pytest.mark.parametrize(
    ("does", "words"),
    [
        ("sys.exit(7)", "got: no word, exit code 7; report it"),
        ("os.kill(os.getpid(), 9)", "got: no word, exit code -9; report it"),
        (r"sys.exit('\n\n  stopped here\nfor good')", "got: stopped here; report it"),
        (r"sys.exit('\nwarning: b\nan error: c')", "got: an error: c; report it"),
        (
            "sys.exit('error: as: No space left on device')",
            "device; free some of the disk, or name others in NPRED_CACHE",
        ),
    ],
)
def test_what_a_compiler_says_that_fails_is_never_empty(tmp_path, monkeypatch, does, words):
    monkeypatch.setattr(compiler, "command", lambda: (sys.executable, "-c", f"import os, sys; {does}"))
    with pytest.raises(NpredError, match=re.escape(words)):
        compiler.library(TEXT.format("13.0"))
    (tmp_path / "cc").write_text(f"#!{sys.executable}\nimport os, sys\n{does}\n")
    (tmp_path / "cc").chmod(0o700)
    monkeypatch.setattr(c_files, "found", lambda: (str(tmp_path / "cc"),))
    with pytest.raises(NpredError, match=re.escape(words.partition(";")[0])):
        c_files.build([], tmp_path / "library.so", "fmu")


def test_a_machine_without_a_compiler_is_told_what_to_install(monkeypatch):
    monkeypatch.setattr(compiler, "found", tuple)
    compiler.command.cache_clear()
    try:
        with pytest.raises(MissingError, match="expected cc, gcc, clang on the PATH, found none; install gcc or clang"):
            compiler.library(TEXT.format("7.0"))
    finally:
        compiler.command.cache_clear()


def test_what_a_loop_needs_is_compiled_side_by_side_and_once(tmp_path, monkeypatch):
    together, original = threading.Barrier(2, timeout=60), compiler._compile
    monkeypatch.setattr(compiler, "_compile", lambda *asked: (together.wait(), original(*asked)))
    texts = [TEXT.format(factor) for factor in ("2.0", "5.0")]
    compiler.prepare(texts)
    compiler.prepare(texts)
    assert [twice(text, 3.0) for text in texts] == [6.0, 15.0]


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs the list of a process's libraries")
def test_with_ziglang_a_kernel_is_linked_with_the_libraries_of_this_process(monkeypatch):
    compiler._libraries.cache_clear()
    monkeypatch.setattr(compiler, "command", lambda: ("python", "-m", "ziglang", "cc"))
    asked = compiler._libraries()
    compiler._libraries.cache_clear()
    assert asked == compiler.STANDARD or (asked[0] == "-nostdlib" and all(Path(path).exists() for path in asked[2:]))


def test_libraries_that_do_not_link_give_way_to_the_standard_ones(monkeypatch):
    monkeypatch.setattr(compiler, "_libraries", lambda: ("-nostdlib", "-Wl,-z,defs"))
    text = "#include <math.h>\ndouble twice(double a) { return sin(a) + a; }"
    assert twice(text, 0.0) == 0.0


NEWEST = max((name for name in COMPILERS if name.startswith("clang")), key=len, default=None)
OTHERS = [  # all compile what is exported; one of them, all loops too, whose kernels take a minute
    pytest.param(name, marks=[] if name == NEWEST else pytest.mark.campaign) for name in COMPILERS if name != "gcc"
]


@pytest.fixture(scope="module")
def under_gcc(tmp_path_factory):
    return found_by(COMPILERS["gcc"], tmp_path_factory.mktemp("gcc"))


def found_by(words, folder):
    """The results of loops that have all parts, under a compiler."""
    command = [sys.executable, HERE / "all_loops.py", folder / "loops.npz", "", *words]
    subprocess.run(command, env=os.environ | {"NPRED_QUIET": "1"}, check=True, timeout=600)
    return dict(np.load(folder / "loops.npz"))


@pytest.mark.slow
@needs_gcc
@pytest.mark.parametrize("name", OTHERS)
def test_loops_under_another_compiler_are_those_under_gcc(under_gcc, tmp_path, name):
    for signal, values in found_by(COMPILERS[name], tmp_path).items():
        expected = under_gcc[signal]
        assert np.isfinite(expected).all() and (np.ptp(expected) > 0 or signal.endswith("D_hat"))
        share = ROUNDED.get(signal.split()[1], OTHERWISE)
        np.testing.assert_allclose(values, expected, rtol=0, atol=share * np.abs(expected).max(), err_msg=signal)
