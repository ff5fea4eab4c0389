"""A trained operator as files: weights and scaling in safetensors, all else in JSON. Nothing is ever unpickled."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from npred import json_files
from npred.config import Network, Train, Training
from npred.data.domain import Domain
from npred.errors import ConfigError, StoreError, first_line
from npred.operators.base import Operator, build
from npred.operators.scaling import Scaling
from npred.plants.base import Plant
from npred.registry import NETWORKS, in_file

MANIFEST = "model.json"


def weights(snapshot: int | None = None) -> str:
    """The name of the file that holds the final weights, or those after `snapshot` epochs."""
    return "model.safetensors" if snapshot is None else f"snapshot-{snapshot}.safetensors"


def save(folder: Path, operator: Operator, config: Training, plant: Plant) -> None:
    """Write model.safetensors, model.json: the network's name, its table, the plant's identity; and its domain."""
    config = config.moved(lambda path: Path(path).name)
    manifest = {"model": config.architecture, "config": config.model_dump(mode="json"), "plant": plant.identity}
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    save_weights(folder / weights(), operator)
    if operator.domain:
        operator.domain.save(folder)


def save_weights(path: Path, operator: Operator) -> None:
    """Write every parameter and buffer, the scaling and the point of rest among them; shared weights each time."""
    save_file({name: tensor.contiguous().clone() for name, tensor in operator.state_dict().items()}, path)


def describe(folder: Path) -> dict[str, Any]:
    """The saved model.json: `model`, `config` and `plant`. Raises StoreError where it is missing or no such object."""
    path = folder / MANIFEST
    try:
        return json_files.table(path)
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: expected a saved model, got: {error}; train it again") from None


def load(
    folder: Path, plant: Plant, snapshot: int | None = None, dtype: torch.dtype = torch.float32,
    config: Training | None = None,
) -> Operator:  # fmt: skip
    """The saved operator, on the CPU and ready for use, as it ended or as it stood after `snapshot` epochs.

    `config`: the pipeline's table of the network, without which the saved one is taken. A network of a file is code:
    only a pipeline may name it, and the saved table alone is refused.

    In float64 the weights are the same and the point of rest is the plant's: the anchor, and with it the end of a
    closed loop, is exact to float64's rounding. In float32 loops end about 2e-6 away.
    Raises StoreError for a file that is missing or broken, ConfigError for a plant that the anchor does not fit.
    """
    config, path = config or _table(folder), folder / weights(snapshot)
    try:
        tensors = load_file(path)
        _check(tensors, config, plant)
        operator = build(config, plant, Scaling(plant.n, plant.m))
        operator.load_state_dict(tensors)
    except (OSError, SafetensorError, RuntimeError, ValueError, TypeError, OverflowError) as error:
        kept = ", ".join(sorted(p.name for p in folder.glob("*.safetensors"))) or "none"
        raise StoreError(
            f"{path}: expected weights of this model, got: {first_line(error)}; files there: {kept}"
        ) from None
    operator.domain = Domain.load(folder)
    return _as(operator, dtype, plant).eval().requires_grad_(False)


def _table(folder: Path) -> Training:
    manifest = describe(folder)
    try:
        model, values = manifest["model"], manifest["config"]
        kind: Any = Network if "network" in values else Train.model_fields[model].annotation
        table = kind.model_validate(values)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        reason, names = " ".join(str(error).split()), ", ".join(NETWORKS.names())
        raise StoreError(f"{folder / MANIFEST}: expected a network of {names}, got: {reason}; train it again") from None
    if in_file(table.architecture):
        raise ConfigError(f"{folder}: expected a registered network, got {table.architecture}; use PIPELINE:MODEL")
    return table


def _check(tensors: dict[str, torch.Tensor], config: Training, plant: Plant) -> None:
    """Raise ValueError unless the tensors are those of the network that the table describes; nothing is allocated."""
    layers = max(config.arguments.get(key, 0) for key in ("layers", "depth"))
    if layers > len(tensors) and config.architecture in NETWORKS.builtin:
        raise ValueError(f"{len(tensors)} tensors for {layers} layers")
    with torch.device("cpu" if in_file(config.architecture) else "meta"):
        expected = build(config, plant, Scaling(plant.n, plant.m)).state_dict()
    for name in sorted(expected.keys() | tensors.keys()):
        shapes = [
            (tuple(t.shape), t.dtype) if (t := state.get(name)) is not None else None for state in (expected, tensors)
        ]
        if shapes[0] != shapes[1]:
            raise ValueError(f"{name}: expected {shapes[0]}, got {shapes[1]}")


def _as(operator: Operator, dtype: torch.dtype, plant: Plant) -> Operator:
    """The operator in another precision, its point of rest, saved in float32, in that precision too."""
    operator = operator.to(dtype)
    if plant.rest and dtype != torch.float32:
        operator.X_rest.copy_(torch.tensor(plant.rest[0]))
        operator.u_rest.copy_(torch.tensor(plant.rest[1]))
    return operator
