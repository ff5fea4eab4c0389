"""The networks of one pipeline in threads, the cells of a sweep in processes; the device that `auto` means."""

from pathlib import Path

import pytest

from npred.base import devices
from npred.base.errors import ConfigError
from npred.lab.scheduler.cells import cells, values


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("5", ["5"]),
        ("32,64,128", ["32", "64", "128"]),
        ("0.5, 1e-3", ["0.5", "1e-3"]),
        ("0:4", ["0", "1", "2", "3"]),
        ("0:10:4", ["0", "4", "8"]),
        ("-2:1", ["-2", "-1", "0"]),
        ("10:12,40", ["10", "11", "40"]),
        ("7,7,7", ["7"]),
        ("[0.01,0.005]", ["[0.01,0.005]"]),
        ("[0.01,0.005],[0.02]", ["[0.01,0.005]", "[0.02]"]),
        ("[[1,2],[3,4]]", ["[[1,2],[3,4]]"]),
        ("{a=1,b=[2,3]},{a=2}", ["{a=1,b=[2,3]}", "{a=2}"]),
        ('"a,b"', ['"a,b"']),
        ('"a,b",c', ['"a,b"', "c"]),
        ("'x]','y'", ["'x]'", "'y'"]),
        ("scalar,my_plant.py:Tank", ["scalar", "my_plant.py:Tank"]),
        ("my_plant.py:Tank", ["my_plant.py:Tank"]),
        ("2020-01-01", ["2020-01-01"]),
    ],
)
def test_the_values_of_a_text(text: str, expected: list[str]):
    assert values(text) == expected


@pytest.mark.parametrize("text", ["5:5", "3:1", "1,,2", "1,", "0:100001"])
def test_what_is_no_list_is_one_line(text: str):
    with pytest.raises(ConfigError, match="--set: expected"):
        values(text)


def test_every_combination_is_a_cell(pipeline: Path):
    found = cells(pipeline, ["seed=0:2", "train.fno.width=4,8,16", "bench.calls=7"])
    assert [cell.values for cell in found] == [
        {"seed": s, "train.fno.width": w} for s in "01" for w in ("4", "8", "16")
    ]
    assert [(c.config.seed, c.config.train.fno.width) for c in found] == [(s, w) for s in (0, 1) for w in (4, 8, 16)]
    assert {cell.config.bench.calls for cell in found} == {7}
    assert found[-1].name == "seed=1 train.fno.width=16"


def test_without_lists_there_is_one_cell(pipeline: Path):
    (cell,) = cells(pipeline, ["bench.dx=[0.01,0.005]"])
    assert (cell.values, cell.name, cell.config.bench.dx) == ({}, "tiny", [0.01, 0.005])


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        (["seed"], "expected key.path=value, got 'seed'"),
        (["=3"], "expected key.path=value"),
        (["seed=1,-1"], "seed: expected at least 0, got -1"),
        (["seed=0:1000", "bench.calls=1:1001"], "at most 100000 cells"),
        (["nonsense=1,2"], "nonsense: unknown key"),
    ],
)
def test_a_bad_grid_is_one_line(pipeline: Path, sets: list[str], words: str):
    with pytest.raises(ConfigError, match=words):
        cells(pipeline, sets)


@pytest.mark.parametrize(("visible", "device"), [(None, "cuda"), ("0", "cuda"), ("", "cpu"), ("-1", "cpu")])
def test_auto_is_a_gpu_that_can_be_seen(monkeypatch: pytest.MonkeyPatch, visible: str | None, device: str):
    gpu(monkeypatch)
    if visible is None:
        monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    else:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert devices.resolve("auto") == device


def test_tests_see_no_gpu(monkeypatch: pytest.MonkeyPatch):
    """The key of a bench names the GPU: what a fixture has made on the CPU would be made again."""
    gpu(monkeypatch)
    assert devices.resolve("auto") == "cpu"


def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this be a machine with a GPU."""
    monkeypatch.setattr(devices, "package", lambda name: "2.15.0+cu130")
    monkeypatch.setattr(Path, "glob", lambda self, pattern: iter([self / "nvidia0"]))


def test_a_machine_with_a_gpu_is_named_by_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """By the driver's files, or where a container has none by torch: a bench's key holds it."""
    torch = pytest.importorskip("torch")
    folder = tmp_path / "0000:01:00.0"
    folder.mkdir()
    (folder / "information").write_text("Model: \t\t NVIDIA H100\nIRQ: 1\n")
    monkeypatch.setattr(devices, "_GPUS", tmp_path)
    assert devices.hardware("cuda:0")["gpus"] == ["NVIDIA H100"] and "gpus" not in devices.hardware("cpu")
    monkeypatch.setattr(devices, "_GPUS", tmp_path / "none")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda k: "NVIDIA H200")
    assert devices.hardware("cuda")["gpus"] == ["NVIDIA H200"]
    assert devices.arithmetic("cuda")["device"] == "cuda, NVIDIA H200"
