"""What the commands do that look after the store and the machine."""

import os
import platform
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from npred import config, devices, places
from npred.cli.options import Common
from npred.errors import ConfigError
from npred.pipeline import STAGES, Planner, nodes
from npred.store import Store

PACKAGES = (
    "npred",
    "numpy",
    "torch",
    "numba",
    "h5py",
    "pydantic",
    "safetensors",
    "typer",
    "onnxruntime",
    "distributed",
)


class Waste(NamedTuple):
    """Something to delete, and why."""

    path: Path
    bytes: int
    reason: str


def gc(options: Common, pipelines: list[Path] | None, yes: bool, device: str) -> None:
    """The plan of what to delete, and with `yes` the deed. Raises ConfigError where no pipeline says what stays."""
    paths = pipelines or sorted(places.PIPELINE.parent.glob("*.toml"))
    if not paths:
        raise ConfigError(
            f"gc: expected pipelines whose results stay, found none in {places.PIPELINE.parent}/; name them"
        )
    kept = {key for path in paths for key in _needed(path, options.results, devices.resolve(device))}
    plan = list(_waste(options.results, kept))
    deleted = [str(waste.path) for waste in plan if yes and options.results.delete(waste.path)]
    rows = [{"path": str(waste.path), "bytes": waste.bytes, "reason": waste.reason} for waste in plan]
    options.show({"plan": rows, "deleted": deleted}, lambda: _told(plan, deleted, yes))


def doctor(options: Common) -> None:
    """Versions, devices, threads and the store."""
    facts = _machine() | _packages() | {"store": _store(options.results)}
    options.show(facts, lambda: "\n".join(f"{name}: {_words(value)}" for name, value in facts.items()))


def _needed(path: Path, store: Store, device: str) -> Iterator[str]:
    pipeline = config.load(path)
    steps = Planner(pipeline, store, device).plan(nodes(pipeline, STAGES))
    return (step.key for step in steps if step.key)


def _waste(store: Store, kept: set[str]) -> Iterator[Waste]:
    for artifact in store.artifacts():
        if artifact.manifest.key not in kept:
            yield Waste(artifact.folder, artifact.size, f"no pipeline needs it (made for {artifact.manifest.pipeline})")
    for folder in store.broken():
        yield Waste(folder, _bytes(folder), "no sound manifest")
    for path in store.leftovers():
        if path.parent.name == ".tmp" or path.name.rpartition("-")[2] not in kept:
            yield Waste(path, _bytes(path), "left by a run that ended early")


def _told(plan: list[Waste], deleted: list[str], yes: bool) -> str:
    if not plan:
        return "nothing to delete"
    lines = [f"{waste.path}  {waste.bytes / 1e6:.1f} MB  {waste.reason}" for waste in plan]
    busy = f", {len(plan) - len(deleted)} in use and kept" if len(deleted) < len(plan) else ""
    last = f"deleted {len(deleted)}{busy}" if yes else f"{len(plan)} to delete; do it with --yes"
    return "\n".join([*lines, last])


def _machine() -> dict[str, Any]:
    import torch

    gpus = [torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())]
    here = {"python": platform.python_version(), "platform": platform.platform()}
    hardware = devices.hardware("cpu")
    return here | {
        "cpu": hardware["cpu"],
        "cores": hardware["cores"],
        "torch_threads": torch.get_num_threads(),
        "gpus": gpus,
    }


def _packages() -> dict[str, Any]:
    return {"packages": {name: devices.package(name) for name in PACKAGES}}


def _store(store: Store) -> dict[str, Any]:
    artifacts = store.artifacts()
    above = next(path for path in [store.root, *store.root.absolute().parents] if path.exists())
    facts = {"path": str(store.root), "writable": os.access(above, os.W_OK), "artifacts": len(artifacts)}
    return facts | {
        "bytes": sum(artifact.size for artifact in artifacts),
        "broken": [str(folder) for folder in store.broken()],
        "leftovers": [str(path) for path in store.leftovers()],
    }


def _bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {item if item is not None else 'absent'}" for key, item in value.items())
    return ", ".join(map(str, value)) or "none" if isinstance(value, list) else str(value)
