"""The log of a run: a file in the store's folder, which no run depends on."""

import os
from pathlib import Path

import pytest

from npred.terminal import run_log
from npred.terminal.run_log import RunLog


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
    monkeypatch.setattr(run_log.time, "strftime", lambda form: "2000-01-01-000000")
    first, second = RunLog.open(tmp_path, "tiny"), RunLog.open(tmp_path, "tiny")
    assert first and second and first.path != second.path
    assert second.path.name == f"2000-01-01-000000-tiny-{os.getpid()}.log"


def test_old_logs_make_room_and_what_is_not_a_log_stays(tmp_path: Path):
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "notes.txt").touch()
    for k in range(run_log.KEPT + 5):
        (folder / f"2000-01-01-{k:06d}-tiny.log").touch()
    log = RunLog.open(tmp_path, "tiny")
    assert log is not None
    names = sorted(path.name for path in folder.iterdir())
    assert len(names) == run_log.KEPT + 1 and names[0] == "2000-01-01-000006-tiny.log"
    assert {"notes.txt", log.path.name} < set(names)


def test_a_store_that_cannot_be_written_has_no_log(tmp_path: Path):
    (tmp_path / "store").write_text("a file")
    assert RunLog.open(tmp_path / "store", "tiny") is None


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_ends_no_run(tmp_path: Path):
    log = RunLog(Path("/dev/full"), open("/dev/full", "w"))  # noqa: SIM115
    log.write("a line")
    log.close()
