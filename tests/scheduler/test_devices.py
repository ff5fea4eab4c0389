"""The device that `auto` means."""

from pathlib import Path

import pytest

from npred.base import devices


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
