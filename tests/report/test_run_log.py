"""The log of a run, signals that end it, and streams that are closed, full or not UTF-8."""

import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import HERE, Call, one_line, process_environment
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from npred.base.errors import MissingError, NpredError
from npred.lab.report.terminal import console as terminal
from npred.lab.report.terminal import streams
from npred.lab.report.terminal.console import Console, Events, RunLog
from npred.lab.store import Store

EPOCHS = [{"epoch": k, "lr": 0.1, "loss": 1.0 / k, "mse": 0.5 / k, "eps_sup": 2.0 / k} for k in (1, 2, 3)]


def read(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Steps and values of each curve."""
    found = EventAccumulator(str(folder)).Reload()
    return {tag: [(event.step, event.value) for event in found.Scalars(tag)] for tag in found.Tags()["scalars"]}


def test_lines_have_the_time_and_move_no_cursor(tmp_path: Path):
    log = RunLog.open(tmp_path / "store", "tiny")
    assert log is not None
    log.write("one\ntwo\x1b[2J")
    log.close()
    log.write("after the end")
    lines = log.path.read_text().splitlines()
    assert [line[8:] for line in lines] == ["  one", r"  two\x1b[2J"]
    assert log.path.parent == tmp_path / "store" / "logs" and log.path.name.endswith("-tiny.log")


def test_two_runs_in_a_second_have_a_log_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(terminal.time, "strftime", lambda form: "2000-01-01-000000")
    first, second = RunLog.open(tmp_path, "tiny"), RunLog.open(tmp_path, "tiny")
    assert first and second and first.path != second.path
    assert second.path.name == f"2000-01-01-000000-tiny-{os.getpid()}.log"


def test_old_logs_make_room_and_what_is_not_a_log_stays(tmp_path: Path):
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "notes.txt").touch()
    for k in range(terminal.KEPT + 5):
        (folder / f"2000-01-01-{k:06d}-tiny.log").touch()
    log = RunLog.open(tmp_path, "tiny")
    assert log is not None
    names = sorted(path.name for path in folder.iterdir())
    assert len(names) == terminal.KEPT + 1 and names[0] == "2000-01-01-000006-tiny.log"
    assert {"notes.txt", log.path.name} < set(names)


def test_a_store_that_cannot_be_written_has_no_log(tmp_path: Path):
    (tmp_path / "store").write_text("a file")
    assert RunLog.open(tmp_path / "store", "tiny") is None


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_ends_no_run(tmp_path: Path):
    log = RunLog(Path("/dev/full"), open("/dev/full", "w"))  # noqa: SIM115
    log.write("a line")
    log.close()


def test_what_a_training_reaches_is_written_by_epoch(tmp_path: Path):
    console = Console(quiet=True, events=Events(tmp_path))
    for row in EPOCHS:
        console.measured("train fno", row)
    assert console.events is not None
    console.events.close()
    curves = read(tmp_path / "train-fno")
    assert set(curves) == {"lr", "loss", "mse", "eps_sup"}
    assert curves["eps_sup"] == [(row["epoch"], pytest.approx(row["eps_sup"])) for row in EPOCHS]


def test_a_training_from_the_store_is_replayed(tmp_path: Path):
    (tmp_path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in EPOCHS))
    events = Events(tmp_path / "events")
    events.replay("train deeponet", tmp_path / "metrics.jsonl")
    events.close()
    assert [step for step, _ in read(tmp_path / "events/train-deeponet")["loss"]] == [1, 2, 3]


def test_without_the_extra_it_says_which(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(MissingError, match=r"pip install 'npred\[tensorboard\]'"):
        Events(tmp_path)


def test_a_command_without_the_extra_ends_with_its_code(call: Call, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    assert "tensorboard" in one_line(call("train", "tiny.toml", "--tensorboard", "events"), 5)


def test_a_run_from_the_store_writes_its_trainings(
    call: Call, reported, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.chdir(reported[0].parent)
    result = call("train", "tiny.toml", "--store", "store", "--tensorboard", str(tmp_path), "--model", "deeponet")
    assert result.exit_code == 0, result.output
    assert [step for step, _ in read(tmp_path / "train-deeponet")["eps_sup"]] == [1, 2]


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
