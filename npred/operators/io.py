"""A trained operator as files: weights and scaling in safetensors, all else in JSON. Nothing is ever unpickled."""

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from npred.config import FNO, DeepONet, Training
from npred.errors import StoreError
from npred.operators.base import Operator
from npred.operators.build import build
from npred.operators.scaling import Scaling
from npred.plants.base import Plant

TABLES: dict[str, type[Training]] = {"deeponet": DeepONet, "fno": FNO}
MANIFEST = "model.json"


def weights(snapshot: int | None = None) -> str:
    """The name of the file that holds the final weights, or those after `snapshot` epochs."""
    return "model.safetensors" if snapshot is None else f"snapshot-{snapshot}.safetensors"


def save(folder: Path, operator: Operator, config: Training, plant: Plant) -> None:
    """Write model.safetensors and model.json: the network's name, its table, the plant's identity."""
    name = next(name for name, table in TABLES.items() if type(config) is table)
    manifest = {"model": name, "config": config.model_dump(mode="json"), "plant": plant.identity}
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    save_weights(folder / weights(), operator)


def save_weights(path: Path, operator: Operator) -> None:
    """Write every parameter and buffer, the scaling and the point of rest among them."""
    save_file({name: tensor.contiguous() for name, tensor in operator.state_dict().items()}, path)


def describe(folder: Path) -> dict[str, Any]:
    """The saved model.json: `model`, `config` and `plant`. Raises StoreError where it is missing or no JSON."""
    path = folder / MANIFEST
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: expected a saved model, got: {error}; train it again") from None


def load(folder: Path, plant: Plant, snapshot: int | None = None, dtype: torch.dtype = torch.float32) -> Operator:
    """The saved operator, on the CPU and ready for use, as it ended or as it stood after `snapshot` epochs.

    In float64 the weights are the same and the point of rest is the plant's own: the anchor, and with it the end of a
    closed loop, is exact to float64's rounding. In float32 loops end about 2e-6 away.
    Raises StoreError for a file that is missing or broken.
    """
    manifest, path = describe(folder), folder / weights(snapshot)
    config = TABLES[manifest["model"]].model_validate(manifest["config"])
    operator = build(config, plant, Scaling(plant.n, plant.m))
    try:
        operator.load_state_dict(load_file(path))
    except (OSError, SafetensorError, RuntimeError) as error:
        kept = ", ".join(sorted(p.name for p in folder.glob("*.safetensors"))) or "none"
        reason = str(error).splitlines()[0]
        raise StoreError(f"{path}: expected weights of this model, got: {reason}; files there: {kept}") from None
    return _as(operator, dtype, plant).eval().requires_grad_(False)


def _as(operator: Operator, dtype: torch.dtype, plant: Plant) -> Operator:
    """The operator in another precision, its point of rest, saved in float32, in that precision too."""
    operator = operator.to(dtype)
    if plant.rests and dtype != torch.float32:
        operator.X_rest.copy_(torch.tensor(plant.equilibrium))
        operator.u_rest.copy_(torch.tensor(plant.u_equilibrium))
    return operator
