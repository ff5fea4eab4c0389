"""Streams that are closed, full or not UTF-8: the work is done, a failure is one line with its exit code."""

import io
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import HERE, process_environment

from npred.base.errors import NpredError
from npred.lab.report.terminal import streams
from npred.lab.store import Store

FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="no /dev/full here")
Shell = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def shell(pipeline: Path) -> Shell:
    """`npred` with fake stages and the given redirections, as a shell runs it; `2>err` and `>out` keep a stream."""

    def call(arguments: str, redirections: str, **environment: str) -> subprocess.CompletedProcess[str]:
        command = f"{sys.executable} {HERE / 'fake_stages.py'} {arguments} {redirections}"
        return subprocess.run(
            ["bash", "-c", command], cwd=pipeline.parent, env=process_environment(**environment), capture_output=True,
            encoding=environment.get("PYTHONIOENCODING", "utf-8"), timeout=60,
        )  # fmt: skip

    return call


def stages_of(pipeline: Path) -> int:
    return len(Store(pipeline.parent / "artifacts").artifacts())


@pytest.mark.parametrize("redirection", ["2>&-", pytest.param("2>/dev/full", marks=needs_full)])
@pytest.mark.parametrize("more", ["", "--json"])
def test_without_stderr_all_is_done_and_answered(shell: Shell, pipeline: Path, redirection: str, more: str):
    done = shell(f"run tiny.toml {more}", redirection)
    assert (done.returncode, stages_of(pipeline)) == (0, 6)
    assert "tiny.html" in done.stdout


@pytest.mark.parametrize(
    ("redirection", "reason"),
    [(">&-", "a closed one"), pytest.param(">/dev/full", "No space left on device", marks=needs_full)],
)
@pytest.mark.parametrize("more", ["", "--json"])
def test_without_stdout_all_is_done_and_one_line_says_so(shell, pipeline: Path, redirection: str, reason: str, more):
    done = shell(f"run tiny.toml -q {more}", redirection)
    assert (done.returncode, stages_of(pipeline)) == (1, 6)
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"error: stdout: expected a stream that takes the answer, got {reason}; the results are")


@needs_full
def test_help_on_a_full_stdout_is_one_line(shell: Shell):
    done = shell("--help", ">/dev/full")
    (line,) = done.stderr.splitlines()
    assert done.returncode == 1 and line.startswith("error: stdout: expected a stream")


def test_without_any_stream_all_is_done(shell: Shell, pipeline: Path):
    assert shell("run tiny.toml", "<&- >&- 2>&-").returncode == 1
    assert stages_of(pipeline) == 6
    for artifact in Store(pipeline.parent / "artifacts").artifacts():
        artifact.verify()


@pytest.mark.parametrize(("encoding", "more"), [("latin-1", ""), ("latin-1", "--json"), ("ascii", "--wide")])
def test_a_stream_that_lacks_characters_gets_them_spelt_out(shell: Shell, pipeline: Path, encoding: str, more: str):
    done = shell(f"run tiny.toml {more}", "", PYTHONIOENCODING=encoding)
    assert (done.returncode, stages_of(pipeline)) == (0, 6), done.stderr
    assert more or r"\u03b5 sup  worst radius  converged  µs per call" in done.stdout
    assert "Error" not in done.stderr


def test_help_on_a_stream_that_lacks_characters(shell: Shell):
    assert shell("--help", "", PYTHONIOENCODING="ascii").returncode == 0


def test_what_a_terminal_obeys_or_hides_is_spelt_out():
    assert streams.printable("a\x1b[2J\n\u202e\u2066\u200b\xadé D̂ ε") == "a\\x1b[2J\n\\u202e\\u2066\\u200b\\xadé D̂ ε"


def test_lines_are_folded_between_words():
    assert streams.folded("  one two three\n\nfour", 10) == "  one two\nthree\n\nfour"
    assert streams.folded("x" * 20, 10) == "x" * 20
    assert streams.folded("one two three", None) == "one two three"


def test_a_reader_that_has_left_is_told_from_a_full_disk(monkeypatch: pytest.MonkeyPatch):
    class Broken(io.StringIO):
        def flush(self) -> None:
            raise error

    monkeypatch.setattr(sys, "stdout", Broken())
    error: OSError = BrokenPipeError()
    with pytest.raises(BrokenPipeError):
        streams.answer("text")
    error = OSError(28, "No space left on device")
    with pytest.raises(NpredError, match="got No space left on device"):
        streams.answer("text")
    sys.stdout.close()
    with pytest.raises(NpredError, match="got a closed one"):
        streams.answer("text")
