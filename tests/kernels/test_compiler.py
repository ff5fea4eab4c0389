"""The compiler: threads that want the same library, texts that do not compile, machines without a compiler."""

import ctypes
from concurrent.futures import ThreadPoolExecutor

import pytest

from npred.errors import MissingError, NpredError
from npred.kernels import cache, compiler

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
    monkeypatch.setattr(compiler, "_compile", lambda folder: (compiled.append(folder), original(folder)))
    with ThreadPoolExecutor(8) as pool:
        assert [*pool.map(lambda _: twice(TEXT.format("2.0"), 21.0), range(8))] == [42.0] * 8
    assert len(compiled) == 1 and len([*tmp_path.iterdir()]) == 1


def test_another_text_is_another_library():
    assert [twice(TEXT.format(factor), 3.0) for factor in ("2.0", "5.0")] == [6.0, 15.0]


def test_a_text_that_does_not_compile_is_told_in_one_line_and_not_kept(tmp_path):
    with pytest.raises(NpredError, match=r"expected a kernel that compiles, got: .*report it") as caught:
        compiler.library("double twice(double a) { return 2.0 * b; }")
    assert "\n" not in str(caught.value) and not [*tmp_path.iterdir()]


def test_a_machine_without_a_compiler_is_told_what_to_install(monkeypatch):
    monkeypatch.setattr(compiler, "found", tuple)
    compiler.command.cache_clear()
    try:
        with pytest.raises(MissingError, match="expected cc, gcc, clang on the PATH, found none; install gcc or clang"):
            compiler.library(TEXT.format("7.0"))
    finally:
        compiler.command.cache_clear()
