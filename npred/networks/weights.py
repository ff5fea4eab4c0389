"""A trained operator and its files, without torch: arrays by name, and the table of its network."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from npred.base import json_files
from npred.base.errors import ConfigError, StoreError, first_line, imported
from npred.base.registry import NETWORKS, in_file
from npred.networks.domain import Domain
from npred.plants.base import Plant

MANIFEST = "model.json"


class NetworkTable(Protocol):
    """The arguments of a network: its name in the registry, its anchor, the keyword arguments of its class."""

    @property
    def architecture(self) -> str: ...
    @property
    def anchor(self) -> str: ...
    @property
    def arguments(self) -> Mapping[str, Any]: ...


class SavedTable(NamedTuple):
    """The table that model.json has."""

    architecture: str
    anchor: str
    arguments: Mapping[str, Any]


class TrainedOperator(Protocol):
    """A trained operator: Weights, or the torch module."""

    @property
    def architecture(self) -> str: ...
    @property
    def domain(self) -> Domain | None: ...
    def weights(self) -> "Weights": ...
    def module(self, plant: Plant) -> Any: ...
    def double(self) -> Any: ...


@dataclass(frozen=True, eq=False)
class Weights:
    """A trained operator: the parameters and buffers of the torch module, and the table that it is built from.

    All floats have one precision, float32 or float64.
    """

    architecture: str
    anchor: str
    arrays: Mapping[str, np.ndarray]
    domain: Domain | None = None
    table: NetworkTable | None = None

    def __getitem__(self, name: str) -> np.ndarray:
        return self.arrays[name]

    def weights(self) -> Self:
        """Itself; an Operator gives its weights."""
        return self

    def module(self, plant: Plant) -> Any:
        """The torch module, on the CPU and ready for use. Raises MissingError without torch."""
        return imported(f"network {self.architecture}", "npred.lab.training.operators.base").filled(self, plant)

    def layers(self, name: str) -> list[dict[str, np.ndarray]]:
        """The arrays of the layers name.0, name.1, … that have any, in order, each by the rest of its name."""
        layers: dict[int, dict[str, np.ndarray]] = {}
        for key, array in self.arrays.items():
            if key.startswith(f"{name}."):
                number, _, part = key.removeprefix(f"{name}.").partition(".")
                layers.setdefault(int(number), {})[part] = array
        return [layers[number] for number in sorted(layers)]

    def double(self) -> Self:
        floats = {name: array.astype(np.float64) for name, array in self.arrays.items() if array.dtype.kind == "f"}
        return replace(self, arrays={**self.arrays, **floats})

    def exact(self, plant: Plant) -> Self:
        """In double precision, the point of rest the plant's own, of which the file has the nearest float32."""
        rest = dict(zip(("X_rest", "u_rest"), plant.rest, strict=True)) if plant.rest else {}
        return replace(self, arrays={**self.arrays, **rest}).double()

    def save(self, path: Path) -> None:
        """Write every array, the scaling and the point of rest among them."""
        save_file(dict(self.arrays), path)


def file_of(snapshot: int | None = None) -> str:
    """The name of the file that holds the final weights, or those after `snapshot` epochs."""
    return "model.safetensors" if snapshot is None else f"snapshot-{snapshot}.safetensors"


def save(folder: Path, operator: TrainedOperator, table: NetworkTable, config: Mapping[str, Any]) -> None:
    """Write model.safetensors, the operator's domain, and model.json: the network's table, and its training's."""
    manifest = {"model": table.architecture, "anchor": table.anchor, "arguments": table.arguments, "config": config}
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    operator.weights().save(folder / file_of())
    if operator.domain:
        operator.domain.save(folder)


def read(
    folder: Path, plant: Plant, snapshot: int | None = None, precision: Any = np.float32,
    table: NetworkTable | None = None,
) -> Weights:  # fmt: skip
    """The saved operator as it ended, or as it stood after `snapshot` epochs. Nothing is unpickled.

    `table`: the pipeline's table of the network, without which the saved one is taken. A network of a file is code:
    only a pipeline may name it, and the saved table alone is refused.

    In float64 the weights are the same and the point of rest is the plant's: the anchor, and with it the end of a
    closed loop, is exact to float64's rounding. In float32 loops end about 2e-6 away.
    Raises StoreError for a file that is missing or broken, ConfigError for a plant that the anchor does not fit,
    MissingError for a network without a fused form where there is no torch.
    """
    table, path = table or _table(folder), folder / file_of(snapshot)
    check_anchor(table.anchor, plant)
    torch = None
    if table.architecture not in NETWORKS.builtin:
        torch = imported(f"network {table.architecture}", "npred.lab.training.operators.base")
    try:
        arrays = load_file(path)
        got = {name: (array.shape, array.dtype.name) for name, array in arrays.items()}
        if torch:
            expected = torch.kinds(table, plant)
        else:
            layers = max(table.arguments.get(key, 0) for key in ("layers", "depth"))
            if layers > len(arrays):  # else a file of a few bytes could ask for any number of them
                raise ValueError(f"{len(arrays)} tensors for {layers} layers")
            expected = {name: (shape, "float32") for name, shape in shapes(table, plant).items()}
        for name in sorted(expected.keys() | got.keys()):
            if expected.get(name) != got.get(name):
                raise ValueError(f"{name}: expected {expected.get(name)}, got {got.get(name)}")
    except (OSError, SafetensorError, RuntimeError, ValueError, TypeError, OverflowError) as error:
        kept = ", ".join(sorted(p.name for p in folder.glob("*.safetensors"))) or "none"
        came = f"{first_line(error)}; files there: {kept}"
        raise StoreError(f"{path}: expected weights of this model, got: {came}") from None
    as_saved = Weights(table.architecture, table.anchor, arrays, Domain.load(folder), table)
    return as_saved if precision == np.float32 else as_saved.exact(plant)


def untrained(table: NetworkTable, plant: Plant, rng: np.random.Generator) -> Weights:
    """Random weights of a network with a fused form, to time its call before there are data."""
    anchor = table.anchor if plant.rest else "initial"
    arrays = {
        name: rng.standard_normal(shape, dtype=np.float32) / np.float32(max(shape[-1:], default=1)) ** 0.5
        for name, shape in shapes(table, plant).items()
    }
    ones = {name: np.ones_like(array) for name, array in arrays.items() if name.startswith("scaling.")}
    return Weights(table.architecture, anchor, arrays | ones, None, table)


def shapes(table: NetworkTable, plant: Plant) -> dict[str, tuple[int, ...]]:
    """The shape of each array of a network with a fused form."""
    n, m = plant.n, plant.m
    network = import_module(NETWORKS.builtin[table.architecture].fused)
    arrays = network.shapes(n, m, 2 if plant.phased else 0, **table.arguments)
    named = {f"network.{name}": shape for name, shape in arrays.items()}
    for name, shape in {"X": (n,), "u": (m,), "D_hat": (), "P": (n,)}.items():
        named |= {f"scaling.{name}_mean": shape, f"scaling.{name}_std": shape}
    named |= {"scaling.X_bend": (n,), "scaling.speed": (n,)}
    return named | {"X_rest": (n,), "u_rest": (m,)}


def check_anchor(anchor: str, plant: Plant) -> None:
    """Raise ConfigError for the anchor `equilibrium` on a plant without one."""
    if anchor == "equilibrium" and not plant.rest:
        raise ConfigError(f"anchor: expected a plant with a rest, {plant.name} has none; use 'initial'")


def _table(folder: Path) -> SavedTable:
    """The saved table of the network. Raises StoreError where it is missing, broken, or of no known network."""
    try:
        manifest = json_files.table(folder / MANIFEST)
        table = SavedTable(str(manifest["model"]), str(manifest["anchor"]), dict(manifest["arguments"]))
        if not in_file(table.architecture) and table.architecture not in NETWORKS.names():
            raise ValueError(table.architecture)
    except (OSError, KeyError, TypeError, ValueError) as error:
        reason, names = " ".join(str(error).split()), ", ".join(NETWORKS.names())
        raise StoreError(f"{folder / MANIFEST}: expected a network of {names}, got: {reason}; train it again") from None
    if in_file(table.architecture):
        raise ConfigError(f"{folder}: expected a registered network, got {table.architecture}; use PIPELINE:MODEL")
    return table
