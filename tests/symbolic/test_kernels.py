"""Kernels: compiled once for a text, found again by it, and never rewritten."""

import subprocess
import sys

import pytest

from npred.symbolic import kernels

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


def test_another_text_is_another_kernel():
    assert kernels.build("twice", "float64(float64)", TEXT)(3.0) == 6.0
    assert kernels.build("twice", "float64(float64)", TEXT.replace("2.0", "5.0"))(3.0) == 15.0


def test_fill_keeps_indentation():
    assert kernels.fill("a\n    {b}\nc {b}", b=["x", "y"]) == "a\n    x\n    y\nc {b}\n"
