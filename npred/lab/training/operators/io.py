"""A trained torch operator as files: weights and scaling in safetensors, all else in JSON. Nothing is unpickled."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from npred.base.registry import in_file
from npred.lab.config import Training
from npred.lab.training.operators.base import Operator, build, ready
from npred.lab.training.operators.scaling import Scaling
from npred.networks import weights as stored
from npred.networks.domain import Domain
from npred.networks.weights import MANIFEST, broken, check, weights
from npred.plants.base import Plant


def save(folder: Path, operator: Operator, config: Training) -> None:
    """Write model.safetensors, model.json: the network's name and its table; and its domain."""
    config = config.map_paths(lambda path: Path(path).name)
    manifest = {
        "model": config.architecture, "anchor": config.anchor, "arguments": config.arguments,
        "config": config.model_dump(mode="json"),
    }  # fmt: skip
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    save_weights(folder / weights(), operator)
    if operator.domain:
        operator.domain.save(folder)


def save_weights(path: Path, operator: Operator) -> None:
    """Write every parameter and buffer, the scaling and the point of rest among them; shared weights each time."""
    save_file({name: tensor.contiguous().clone() for name, tensor in operator.state_dict().items()}, path)


def load(
    folder: Path, plant: Plant, snapshot: int | None = None, dtype: torch.dtype = torch.float32,
    config: Training | None = None,
) -> Operator:  # fmt: skip
    """The saved operator as a torch module, on the CPU and ready for use: see npred.lab.training.operators.read, also
    for what it raises.
    """
    precision = torch.empty(0, dtype=dtype).cpu().numpy().dtype
    return stored.read(folder, plant, snapshot, precision, config).module(plant)


def read(path: Path, plant: Plant, precision: Any, config: Training, domain: Domain | None) -> Operator:
    """A network of which only its class says what the file has to hold; nothing is allocated before that is checked."""
    with broken(path):
        tensors = load_file(path)
        with torch.device("cpu" if in_file(config.architecture) else "meta"):
            expected = build(config, plant, Scaling(plant.n, plant.m)).state_dict()
        check(_kinds(expected), _kinds(tensors))
        operator = build(config, plant, Scaling(plant.n, plant.m))
        operator.load_state_dict(tensors)
    operator.to(torch.from_numpy(np.empty(0, dtype=precision)).dtype)
    if plant.rest and precision != np.float32:
        operator.X_rest.copy_(torch.tensor(plant.rest[0]))
        operator.u_rest.copy_(torch.tensor(plant.rest[1]))
    return ready(operator, domain)


def _kinds(tensors: dict[str, torch.Tensor]) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape and type of each, as a message has them."""
    return {name: (tuple(t.shape), str(t.dtype).removeprefix("torch.")) for name, t in tensors.items()}
