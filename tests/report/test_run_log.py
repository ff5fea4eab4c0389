"""What a run writes for later: the log in the store, which no run depends on, and the event files of TensorBoard."""

import json
import os
import sys
from pathlib import Path

import pytest
from conftest import Call, one_line
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from npred.base.errors import MissingError
from npred.lab.report.terminal import console as terminal
from npred.lab.report.terminal.console import Console, Events, RunLog

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
