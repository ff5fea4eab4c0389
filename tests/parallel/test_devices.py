"""The device that `auto` means."""

from pathlib import Path

import pytest

from npred.parallel import devices


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
