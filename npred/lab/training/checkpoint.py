"""The checkpoint of a training: one safetensors file, replaced in one step; nothing is ever unpickled.

It holds a digest of all that is in it and of the snapshots beside it: a bit that flips must not become a result.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from npred.base import json_files
from npred.base.errors import StoreError, first_line

NAME = "checkpoint.safetensors"
Metrics = list[dict[str, Any]]


def save(folder: Path, network: nn.Module, optimiser: torch.optim.Optimizer, metrics: Metrics) -> None:
    """Write parameters, buffers and the optimiser's moments as tensors, the metrics so far as JSON in the header.

    The file is complete or absent: it is written beside its name, synced and renamed.
    """
    partial = folder / f"{NAME}.partial"
    moments = {
        f"optimiser/{index}/{key}": tensor.clone()  # several may be views of one tensor, which no file may hold
        for index, state in optimiser.state_dict()["state"].items()
        for key, tensor in state.items()
    }
    tensors = {**network.state_dict(), **moments}
    snapshots = {path.name: json_files.sha256(path) for path in sorted(folder.glob("snapshot-*.safetensors"))}
    texts = {"metrics": json.dumps(metrics), "snapshots": json.dumps(snapshots)}  # parts of the result as they are
    save_file(tensors, partial, metadata=texts | {"sha256": _digest(tensors, texts)})
    json_files.sync(partial)
    partial.replace(folder / NAME)


def restore(folder: Path, network: nn.Module, optimiser: torch.optim.Optimizer) -> Metrics:
    """Load the folder's checkpoint in place, if there is one; the metrics of the epochs behind it, else none.

    Raises StoreError for a file that is broken or was changed, and for such a snapshot.
    """
    path = folder / NAME
    if not path.exists():
        return []
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no mapping
            texts = file.metadata()
        if texts.pop("sha256", "") != _digest(tensors, texts):
            raise ValueError("other bytes than were written")
        for name, digest in json_files.parse(texts["snapshots"]).items():
            if not (folder / name).is_file() or json_files.sha256(folder / name) != digest:
                raise ValueError(f"{name} missing or with other bytes than were written")
        network.load_state_dict({name: tensors.pop(name) for name in network.state_dict()})
        state: dict[int, dict[str, Tensor]] = {}
        for name, tensor in tensors.items():
            _, index, key = name.split("/")
            state.setdefault(int(index), {})[key] = tensor
        optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
        return json_files.parse(texts["metrics"])
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        expected = f"{path}: expected a checkpoint, got: {first_line(error)}"
        raise StoreError(f"{expected}; delete it to start over") from None


def _digest(tensors: dict[str, Tensor], texts: dict[str, str]) -> str:
    """The sha256 of names, types, shapes and bytes of tensors, and of the texts beside them."""
    digest = hashlib.sha256(json.dumps(texts, sort_keys=True).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return digest.hexdigest()
