"""A trained operator as its files have it, read without torch: arrays by name, and its table. Nothing is unpickled."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file

from npred.base import json_files, registry
from npred.base.errors import ConfigError, StoreError, first_line, imported
from npred.base.registry import NETWORKS, in_file
from npred.networks import layouts
from npred.networks.domain import Domain
from npred.plants.base import Plant

MANIFEST = "model.json"
LARGEST = 2**53  # of anything that is counted


class NetworkTable(Protocol):
    """What a network is built from: its name in the registry, its anchor, the keyword arguments of its class."""

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

    domain: Any

    def weights(self) -> "Weights": ...
    def module(self, plant: Plant) -> Any: ...
    def double(self) -> Any: ...


@dataclass(frozen=True, eq=False)
class Weights:
    """A trained operator of a network with a fused form: the parameters and buffers of the torch module.

    All arrays have one precision, float32 or float64. `table` is what a torch module is built from.
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
        """The arrays of the layers name.0, name.1, … that have any, in order, each by what follows its number."""
        layers: dict[int, dict[str, np.ndarray]] = {}
        for key, array in self.arrays.items():
            if key.startswith(f"{name}."):
                number, _, part = key.removeprefix(f"{name}.").partition(".")
                layers.setdefault(int(number), {})[part] = array
        return [layers[number] for number in sorted(layers)]

    def double(self) -> Self:
        return replace(self, arrays={name: array.astype(np.float64) for name, array in self.arrays.items()})

    def exact(self, plant: Plant) -> Self:
        """In double precision, the point of rest the plant's own, of which the file has the nearest float32."""
        rest = zip(("X_rest", "u_rest"), plant.rest, strict=True) if plant.rest else ()
        arrays = {name: array.astype(np.float64) for name, array in {**self.arrays, **dict(rest)}.items()}
        return replace(self, arrays=arrays)


def weights(snapshot: int | None = None) -> str:
    """The name of the file that holds the final weights, or those after `snapshot` epochs."""
    return "model.safetensors" if snapshot is None else f"snapshot-{snapshot}.safetensors"


def describe(folder: Path) -> dict[str, Any]:
    """The saved model.json: `model`, `config` and `plant`. Raises StoreError where it is missing or no such object."""
    path = folder / MANIFEST
    try:
        return json_files.table(path)
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: expected a saved model, got: {error}; train it again") from None


def read(
    folder: Path, plant: Plant, snapshot: int | None = None, precision: Any = np.float32,
    table: NetworkTable | None = None,
) -> TrainedOperator:  # fmt: skip
    """The saved operator as it ended, or as it stood after `snapshot` epochs: a torch module where it has no fused
    form.

    `table`: the pipeline's table of the network, without which the saved one is taken. A network of a file is code:
    only a pipeline may name it, and the saved table alone is refused.

    In float64 the weights are the same and the point of rest is the plant's: the anchor, and with it the end of a
    closed loop, is exact to float64's rounding. In float32 loops end about 2e-6 away.
    Raises StoreError for a file that is missing or broken, ConfigError for a plant that the anchor does not fit,
    MissingError where the network needs torch and there is none.
    """
    table, path = table or _table(folder), folder / weights(snapshot)
    check_anchor(table.anchor, plant)
    domain, entry = Domain.load(folder), NETWORKS.builtin.get(table.architecture)
    if entry is None:
        files = imported(f"network {table.architecture}", "npred.lab.training.operators.io")
        return files.read(path, plant, precision, table, domain)
    with broken(path):
        arrays = load_file(path)
        layers = max(table.arguments.get(key, 0) for key in ("layers", "depth"))
        if layers > len(arrays):  # else a file of a few bytes could ask for any number of them
            raise ValueError(f"{len(arrays)} tensors for {layers} layers")
        check(
            {name: (shape, "float32") for name, shape in _shapes(table, plant).items()},
            {name: (array.shape, array.dtype.name) for name, array in arrays.items()},
        )
    as_saved = Weights(table.architecture, table.anchor, arrays, domain, table)
    return as_saved if precision == np.float32 else as_saved.exact(plant)


def untrained(table: NetworkTable, plant: Plant, rng: np.random.Generator) -> Weights:
    """Random weights of a network with a fused form: what a call of it takes, before there are data."""
    anchor = table.anchor if plant.rest else "initial"
    arrays = {
        name: rng.standard_normal(shape, dtype=np.float32) / np.float32(max(shape[-1:], default=1)) ** 0.5
        for name, shape in _shapes(table, plant).items()
    }
    ones = {name: np.ones_like(array) for name, array in arrays.items() if name.startswith("scaling.")}
    return Weights(table.architecture, anchor, arrays | ones, None, table)


def _shapes(table: NetworkTable, plant: Plant) -> layouts.Shapes:
    """The shape of each array of a network with a fused form."""
    layout = registry.attribute(NETWORKS.builtin[table.architecture].layout)
    network = layout(plant.n, plant.m, 2 if plant.phased else 0, **table.arguments)
    shapes = {f"network.{name}": shape for name, shape in network.items()}
    shapes |= {f"scaling.{name}": shape for name, shape in layouts.scaling(plant.n, plant.m).items()}
    return shapes | {"X_rest": (plant.n,), "u_rest": (plant.m,)}


def check_anchor(anchor: str, plant: Plant) -> None:
    """Raise ConfigError for the anchor `equilibrium` on a plant without one."""
    if anchor == "equilibrium" and not plant.rest:
        raise ConfigError(f"anchor: expected a plant with an equilibrium, {plant.name} has none; use 'initial'")


@contextmanager
def broken(path: Path) -> Iterator[None]:
    """What a file of weights fails with as a StoreError in one line."""
    try:
        yield
    except (OSError, SafetensorError, RuntimeError, ValueError, TypeError, OverflowError) as error:
        kept = ", ".join(sorted(p.name for p in path.parent.glob("*.safetensors"))) or "none"
        raise StoreError(
            f"{path}: expected weights of this model, got: {first_line(error)}; files there: {kept}"
        ) from None


def check(expected: Mapping[str, Any], kinds: Mapping[str, Any]) -> None:
    """Raise ValueError unless the names are the same, and for each name the shape and the type."""
    for name in sorted(expected.keys() | kinds.keys()):
        if expected.get(name) != kinds.get(name):
            raise ValueError(f"{name}: expected {expected.get(name)}, got {kinds.get(name)}")


def _table(folder: Path) -> SavedTable:
    manifest = describe(folder)
    try:
        table = SavedTable(str(manifest["model"]), str(manifest["anchor"]), dict(manifest["arguments"]))
        if not in_file(table.architecture) and table.architecture not in NETWORKS.names():
            raise ValueError(table.architecture)
        for name, value in table.arguments.items():
            if isinstance(value, int) and not 0 <= value <= LARGEST:
                raise ValueError(f"{value} as {name}")
    except (KeyError, TypeError, ValueError) as error:
        reason, names = " ".join(str(error).split()), ", ".join(NETWORKS.names())
        raise StoreError(f"{folder / MANIFEST}: expected a network of {names}, got: {reason}; train it again") from None
    if in_file(table.architecture):
        raise ConfigError(f"{folder}: expected a registered network, got {table.architecture}; use PIPELINE:MODEL")
    return table
