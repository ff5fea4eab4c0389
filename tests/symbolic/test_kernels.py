"""Kernels: compiled once for a text, found again by it, and never rewritten."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event

import pytest

from npred.symbolic import compile_cache, kernels

TEXT = "def twice(a):\n    return 2.0 * a\n"
PROGRAM = """
from npred.symbolic import compile_cache, kernels
twice = kernels.build("twice", "float64(float64)", "def twice(a):\\n    return 2.0 * a\\n")
print(twice(21.0), len(twice._cache_hits) and sum(twice._cache_hits.values()), compile_cache.folder())
"""


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    return tmp_path / "kernels"


def run():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=120)
    value, hits, folder = done.stdout.split()
    return float(value), int(hits), folder


def test_second_process_finds_the_compiled_kernel(fresh):
    assert run() == (42.0, 0, str(fresh))
    (source,) = fresh.glob("npred_twice_*.py")
    stamp = source.stat().st_mtime_ns
    assert run() == (42.0, 1, str(fresh))
    assert source.stat().st_mtime_ns == stamp


@pytest.mark.parametrize("found", ["inner", "missing"])
def test_threads_that_want_the_same_kernels_find_them_whole(fresh, monkeypatch, found):
    """Eight threads build a kernel that imports another. Those that come second, if they begin the inner one again, are
    held up between its name and its content until the first one has imported it.
    """
    fresh.mkdir(parents=True)
    monkeypatch.setattr(compile_cache, "root", lambda: fresh)
    inner_is_there, outer_is_there, begun = Event(), Event(), []
    make, kept = kernels.ModuleType, compile_cache.kept

    def made(name):
        begun.append(name)
        if "_inner_" in name and len(begun) > 1:
            inner_is_there.wait(20)
        return make(name)

    @contextmanager
    def slowly_kept(name):
        if "_inner_" in name and inner_is_there.is_set():
            outer_is_there.wait(20)
        with kept(name):
            yield

    def built(number):
        inner = kernels.build("inner", "float64(float64)", "def inner(a):\n    return 2.0 * a\n")
        inner_is_there.set()
        preamble = f"from {inner.__module__} import {found}\n"
        try:
            outer = kernels.build(
                "outer", "float64(float64)", f"def outer(a):\n    return {found}(a) + 1.0\n", preamble
            )
        finally:
            outer_is_there.set()
        return outer(3.0)

    monkeypatch.setattr(kernels, "ModuleType", made)
    monkeypatch.setattr(compile_cache, "kept", slowly_kept)
    with ThreadPoolExecutor(8) as pool:
        results = [pool.submit(built, number) for number in range(8)]
    if found == "missing":  # what failed is not taken for a kernel
        assert {str(done.exception()).partition(" from")[0] for done in results} == {"cannot import name 'missing'"}
    else:
        assert [done.result() for done in results] == [7.0] * 8
        assert len(begun) == 2


def test_another_text_is_another_kernel():
    assert kernels.build("twice", "float64(float64)", TEXT)(3.0) == 6.0
    assert kernels.build("twice", "float64(float64)", TEXT.replace("2.0", "5.0"))(3.0) == 15.0


def test_fill_keeps_indentation():
    assert kernels.fill("a\n    {b}\nc {b}", b=["x", "y"]) == "a\n    x\n    y\nc {b}\n"
