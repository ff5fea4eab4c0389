"""Where an interrupted training goes on: one safetensors file, replaced in one step; nothing is ever unpickled."""

import json
import os
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from npred import documents
from npred.errors import StoreError

NAME = "checkpoint.safetensors"
Metrics = list[dict[str, Any]]


def save(folder: Path, network: nn.Module, optimiser: torch.optim.Optimizer, metrics: Metrics) -> None:
    """Write parameters, buffers and the optimiser's moments as tensors, the metrics so far as JSON in the header.

    The file is complete or absent: it is written beside its name, synced and renamed.
    """
    partial = folder / f"{NAME}.partial"
    save_file(_tensors(network, optimiser), partial, metadata={"metrics": json.dumps(metrics)})
    with partial.open("rb") as file:
        os.fsync(file.fileno())
    partial.replace(folder / NAME)


def restore(folder: Path, network: nn.Module, optimiser: torch.optim.Optimizer) -> Metrics:
    """Load the folder's checkpoint in place, if there is one; the metrics of the epochs behind it, else none.

    Raises StoreError for a file that is broken.
    """
    if not (folder / NAME).exists():
        return []
    try:
        return _restored(folder / NAME, network, optimiser)
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise StoreError(f"{folder / NAME}: expected a checkpoint, got: {reason}; delete it to start over") from None


def _restored(path: Path, network: nn.Module, optimiser: torch.optim.Optimizer) -> Metrics:
    with safe_open(path, framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
        metrics = documents.parse(file.metadata()["metrics"])
    network.load_state_dict({name: tensors.pop(name) for name in network.state_dict()})
    state: dict[int, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        _, index, key = name.split("/")
        state.setdefault(int(index), {})[key] = tensor
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
    return metrics


def _tensors(network: nn.Module, optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    moments = {
        f"optimiser/{index}/{key}": tensor
        for index, state in optimiser.state_dict()["state"].items()
        for key, tensor in state.items()
    }
    return {**network.state_dict(), **moments}
