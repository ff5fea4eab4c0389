"""The device that the work runs on, and the machine in words. torch is imported to check CUDA only."""

import os
import platform
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from npred.base import json_files
from npred.base.errors import ConfigError, MissingError, installed, required

_CPUINFO = Path("/proc/cpuinfo")
_VECTOR = re.compile("avx|amx|fma|f16c|sse4|asimd|sve|bf16")
# Variables that the libraries read on their start to choose instructions and the order of sums.
_MODES = (
    "MKL_ENABLE_INSTRUCTIONS", "MKL_DEBUG_CPU_TYPE", "ATEN_CPU_CAPABILITY", "ONEDNN_MAX_CPU_ISA",
    "DNNL_MAX_CPU_ISA", "OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "NPY_ENABLE_CPU_FEATURES", "NUMBA_CPU_NAME",
    "NUMBA_CPU_FEATURES", "OMP_NUM_THREADS", "MKL_NUM_THREADS",
)  # fmt: skip
_GPUS = Path("/proc/driver/nvidia/gpus")


def resolve(requested: str) -> str:
    """The device meant by `auto`, `cpu`, `cuda` or `cuda:N`, without torch. Raises ConfigError for anything else."""
    if requested == "auto":
        built_for_cpu = "+cpu" in (package("torch") or "+cpu")
        hidden = os.environ.get("CUDA_VISIBLE_DEVICES") in ("", "-1")
        return "cuda" if not built_for_cpu and not hidden and any(Path("/dev").glob("nvidia[0-9]*")) else "cpu"
    if not re.fullmatch(r"cpu|cuda(:\d+)?", requested):
        raise ConfigError(f"device: expected auto, cpu, cuda or cuda:N, got {requested!r}; choose one of those")
    return requested


def require(device: str) -> None:
    """Raise MissingError unless this machine has the device."""
    if device == "cpu":
        return
    torch = required("device", "torch", "torch", "train")
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if int(device.partition(":")[2] or 0) >= count:
        raise MissingError(f"device: expected one of this machine, got {device!r} with {count} CUDA devices; use cpu")


def cores() -> int:
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def torch_threads(count: int) -> None:
    """Let torch, where it is installed, compute on so many threads from now on."""
    if installed("torch"):
        import torch

        torch.set_num_threads(count)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch, where it is loaded, compute on the caller's thread.

    A control step of a network is a hundred small operations. After each, torch's threads wait for each other: beside
    a busy process, some hundred times as long as they compute.
    """
    if (torch := sys.modules.get("torch")) is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def hardware(device: str) -> dict[str, object]:
    """All that a timing depends on: processor, cores and, on CUDA, the GPUs by name."""
    described: dict[str, object] = {"cpu": _cpu(), "cores": cores(), "device": device.partition(":")[0]}
    return described if device == "cpu" else described | {"gpus": _gpus()}


def arithmetic(device: str) -> dict[str, str | None]:
    """All that the last digits of a result depend on beyond its question: processor, vector units, modes of libraries.

    `torch_kernels` is the set of kernels that torch chose, None where torch was not needed.
    """
    torch = sys.modules.get("torch")
    settings = " ".join(f"{name}={os.environ[name]}" for name in _MODES if os.environ.get(name))
    cpu = _cpuinfo()
    flags = set((cpu.get("flags") or cpu.get("Features", "")).split())  # by the kernel's names
    facts = {
        "device": "cpu" if device == "cpu" else ", ".join(["cuda", *_gpus()]),
        "cpu": _cpu(),
        "cpu_features": " ".join(sorted(flag for flag in flags if _VECTOR.match(flag))),
        "torch_kernels": torch.backends.cpu.get_cpu_capability() if torch else None,
        "mkl_mode": os.environ.get("MKL_CBWR") or "default",
        "arithmetic_settings": settings or None,
    }
    return {name: value and json_files.escaped(value) for name, value in facts.items()}


def package(name: str) -> str | None:
    """The installed version of a package, read from its metadata; None where it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def packages(*names: str) -> dict[str, str | None]:
    """The installed versions of packages, by name."""
    return {name: package(name) for name in names}


def _cpu() -> str:
    return _cpuinfo().get("model name") or platform.processor() or platform.machine()


def _cpuinfo() -> dict[str, str]:
    """The kernel's facts of the first core; none where it gives none."""
    lines = _CPUINFO.read_text(encoding="utf-8").splitlines() if _CPUINFO.exists() else []
    facts = (line.partition(":") for line in reversed(lines))
    return {name.strip(): value.strip() for name, _, value in facts}


def _gpus() -> list[str]:
    """As the driver names them, else as torch does: in some containers the driver's files are not there."""
    texts = [path.read_text() for path in _GPUS.glob("*/information")] if _GPUS.exists() else []
    models = sorted(line.partition(":")[2].strip() for text in texts for line in text.splitlines() if "Model:" in line)
    if models or package("torch") is None:
        return models
    import torch

    return sorted(torch.cuda.get_device_name(k) for k in range(torch.cuda.device_count()))
