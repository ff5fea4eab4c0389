"""TensorBoard's event files: what an epoch reached, from a running training and from one that the store had."""

import json
import sys
from pathlib import Path

import pytest
from conftest import Call, one_line
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from npred.errors import MissingError
from npred.terminal.console import Console
from npred.terminal.tensorboard import Events

EPOCHS = [{"epoch": k, "lr": 0.1, "loss": 1.0 / k, "mse": 0.5 / k, "eps_sup": 2.0 / k} for k in (1, 2, 3)]


def read(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Steps and values of each curve."""
    found = EventAccumulator(str(folder)).Reload()
    return {tag: [(event.step, event.value) for event in found.Scalars(tag)] for tag in found.Tags()["scalars"]}


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
