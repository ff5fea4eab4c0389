"""The word on slow work: one line, in time, and none of what is quick, cached or quiet."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import process_environment

from npred.base import progress

LOOP = """
import numpy as np
import npred

plant = npred.plant("scalar")
rk4 = npred.predictor(plant, "rk4")
rk4([1.0], np.zeros((101, 1)), 1.0)
npred.simulate(plant, rk4, D=0.2, D_hat=0.3, X0=[1.0], t_end=1.0)
"""


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """The lines that come of work that takes 0.05 s without a word; what takes less than 0.2 s is short."""
    monkeypatch.delenv(progress.VARIABLE, raising=False)
    monkeypatch.setattr(progress, "PATIENCE", 0.05)
    monkeypatch.setattr(progress, "SHORT", 0.2)
    heard: list[str] = []
    with progress.listener(heard.append):
        yield heard


def hold(lines: list[str], seconds: float = 10.0) -> None:
    """Wait until a line is there, for so long at most."""
    over = threading.Event()
    for _ in range(round(seconds / 0.01)):
        if lines or over.wait(0.01):
            return


def test_work_that_lasts_says_what_how_long_and_how_often(lines: list[str]):
    with progress.announce("compiling 5 kernels", 3.2, "once per plant"):
        hold(lines)
    assert lines == ["compiling 5 kernels: about 3 s, once per plant"]


def test_quick_work_says_nothing(lines: list[str]):
    with progress.announce("compiling", 3.0):
        pass
    assert lines == []


def test_work_that_is_counted_to_end_soon_says_nothing_unless_it_lasts(lines: list[str]):
    with progress.announce("simulating", total=100) as work:
        work.advance(99)
        threading.Event().wait(0.1)
        assert lines == []
        hold(lines)
    assert lines == ["simulating: about 1 s"]


def test_a_guess_of_a_short_time_delays_no_line(lines: list[str], monkeypatch: pytest.MonkeyPatch):
    """A slow machine, or a slow compiler, makes the guess wrong."""
    monkeypatch.setattr(progress, "SHORT", 1000.0)
    with progress.announce("compiling", 0.1):
        hold(lines)
    assert lines == ["compiling: about 1 s"]


def test_the_time_follows_from_the_units_done(lines: list[str]):
    with progress.announce("simulating", total=1000) as work:
        work.advance(1)
        hold(lines)
    (line,) = lines
    assert line.startswith("simulating: about ")


def test_what_comes_before_the_first_units_is_not_multiplied(monkeypatch: pytest.MonkeyPatch):
    times = iter([0.0, 1.0, 1.5])  # of the beginning, of the first units' beginning, of their end
    monkeypatch.setattr(progress.time, "perf_counter", lambda: next(times))
    work = progress.Pending("simulating", None, "", total=100)
    work.advance(0)
    work.advance(10)
    assert work.expected == pytest.approx(1.0 + 0.5 * 10)


def test_the_time_is_counted_at_the_last_unit(lines: list[str], monkeypatch: pytest.MonkeyPatch):
    """A block of 500 steps may come long after the first 10, and says nothing of them before it ends."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    with progress.announce("simulating", total=1000) as work:
        now[0] = 0.1
        work.advance(20)
        now[0] = 4.0
        hold(lines)
    assert lines == ["simulating: about 5 s"]


def test_work_within_work_adds_no_line_and_its_end_is_no_end_of_the_quiet(lines: list[str]):
    with progress.announce("simulating", 10.0):
        with progress.announce("compiling", 10.0):
            hold(lines)
        threading.Event().wait(0.1)
    assert lines == ["simulating: about 10 s"]


def test_nobody_hears_of_work_that_is_quiet(lines: list[str], monkeypatch: pytest.MonkeyPatch):
    with progress.quiet(), progress.announce("simulating", 10.0):
        hold(lines, 0.2)
    monkeypatch.setenv(progress.VARIABLE, "1")
    with progress.announce("simulating", 10.0):
        hold(lines, 0.2)
    assert lines == []


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "1 s"), (59, "59 s"), (100, "2 min"), (9000, "2 h")])
def test_a_duration_in_words(seconds: float, text: str):
    assert progress.duration(seconds) == text


def run(cache: Path, **environment: str) -> str:
    """What a script of a first call and a first loop says on stderr."""
    environment = process_environment(**{"NPRED_CACHE": str(cache), progress.VARIABLE: ""} | environment)
    return subprocess.run(
        [sys.executable, "-c", LOOP], env=environment, capture_output=True, text=True, check=True, timeout=300
    ).stderr


def compiler(folder: Path, seconds: float) -> Path:
    """A folder with a `cc` that takes so much longer."""
    folder.mkdir()
    (folder / "cc").write_text(f'#!/bin/sh\ncase "$*" in *-o*) /bin/sleep {seconds};; esac\nexec /usr/bin/cc "$@"\n')
    (folder / "cc").chmod(0o755)
    return folder


@pytest.mark.slow
@pytest.mark.skipif(not Path("/usr/bin/cc").exists(), reason="needs a compiler to slow down")
def test_a_first_loop_speaks_of_each_compilation_once_and_of_none_that_is_cached(tmp_path: Path):
    path = f"{compiler(tmp_path / 'bin', 3)}:/usr/bin:/bin"
    first, second = run(tmp_path / "cache", PATH=path), run(tmp_path / "cache", PATH=path)
    assert [line.partition(":")[0] for line in first.splitlines()] == ["npred"] * 2
    assert "compiling a kernel" in first
    assert "compiling 3 kernels" in first
    assert second == ""
    assert run(tmp_path / "other", PATH=path, NPRED_QUIET="1") == ""
