"""Trained models and data by name: `pipeline/paper.toml:deeponet@107` to verified files of the store."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from npred import networks as runtimes
from npred import plants
from npred.base import defaults, devices, progress
from npred.base.errors import ConfigError, unlisted
from npred.lab import config
from npred.lab.config import Training
from npred.lab.config.results import PredictorId
from npred.lab.scheduler.configuration import identity
from npred.lab.scheduler.plan import Planner, nodes
from npred.lab.scheduler.sources import resolved
from npred.lab.store import Artifact, Store
from npred.lab.training.data import shards
from npred.lab.training.data.dataset import Dataset
from npred.networks import weights
from npred.plants import Plant
from npred.prediction.methods import Predictor


class Stored(NamedTuple):
    """A trained model; `snapshot` is an epoch, None for the final weights, `config` the table that names it."""

    folder: Path
    model: str
    snapshot: int | None
    plant: Plant
    config: Training | None


def load(
    model: str, *, settings: Mapping[str, Any] = {}, store: str | Path | None = None, nx: int = 101,
    device: str = "cpu", runtime: str | None = None,
) -> Predictor:  # fmt: skip
    """A trained model as a predictor.

    The compiled function is made at its first use in a loop or controller and kept on the disk. On a GPU, and for a
    network of yours, torch does all. Files are verified against their digests. The plant is the pipeline's, or, for an
    artifact, the built-in one of that name: a plant's file is code and is run only when a pipeline names it.

    Parameters
    ----------
    model : "pipeline/paper.toml:deeponet", "…:deeponet@107", or the path or key of an artifact
        The trained model.
    settings : dict, optional
        Keys of the pipeline, as those of the --set that it was trained with, with their values:
        {"train.deeponet.epochs": 20}.
    store : str or Path, optional
        Folder of results; by default NPRED_STORE, else artifacts/. What it has is not made again.
    nx : int, default 101
        Nodes on [0, 1], both ends included.
    device : "auto", "cpu", "cuda" or "cuda:N", default "cpu"
        Where networks run.
    runtime : "torch", "fused", "onnx", one of a package, or a class of a file, "my_runtime.py:Mine", optional
        What runs the network. By default a compiled function in float64 in loops, and torch for batches; fused is
        in float32 and takes half the time.

    Returns
    -------
    Predictor
        P(x) = X + D_hat ∫₀ˣ f(P(y), u(y)) dy on nx uniform nodes, both ends in [DAPF, eq. 10].

    Raises
    ------
    ConfigError
        For a model or a runtime that is not there.
    StoreError
        For corrupt results.
    MissingError
        For a device or an extra that this machine lacks.
    """
    if not isinstance(model, str | Path):
        raise ConfigError(f"model: expected PIPELINE:MODEL, a path or a key, got {model!r}; write smoke:deeponet, say")
    devices.require(devices.resolve(device))
    return loaded(load_model(str(model), Path(store) if store else None, settings), nx, device, runtime)


def loaded(stored: Stored, nx: int, device: str, runtime: str | None) -> Predictor:
    """A trained model of the store as a predictor; see `load`."""
    device = devices.resolve(device)
    devices.require(device)
    with progress.announce(f"loading network {stored.model}", often="once per process"):
        precision = np.float64 if runtime in (None, "torch") else np.float32
        operator = weights.read(stored.folder, stored.plant, stored.snapshot, precision, stored.config)
        return runtimes.predictor(runtime, stored.plant, operator, nx, stored.model, device)


def load_model(spec: str, root: Path | None = None, overrides: list[str] | Mapping[str, Any] | None = None) -> Stored:
    """The trained model meant by `PIPELINE:MODEL`, `MODEL` (of the default pipeline), an artifact's folder or key.

    Each may end in `@EPOCH`, for a snapshot; `overrides` of the pipeline are as for config.load, or keys and values.
    Raises ConfigError where there is none, and for overrides without a pipeline; StoreError for corrupt files.
    """
    store = Store(root or defaults.store())
    try:
        asked = PredictorId.parse(spec)
    except ValueError as error:
        raise ConfigError(f"{spec}: {error}") from None
    path, colon, name = asked.model.rpartition(":")
    if not colon and (name.endswith(".toml") or name in defaults.shipped()) and name not in config.Train().names:
        raise ConfigError(f"{spec}: expected PIPELINE:MODEL, got no model; write {spec}:deeponet, say")
    if colon or _of_default(name):
        file = defaults.pipeline(path)
        by_key = isinstance(overrides, Mapping)
        pipeline = resolved(file, overrides) if by_key else config.load(file, overrides)
        if name not in (names := pipeline.train.names):
            raise ConfigError(unlisted(f"{spec}: after the colon", name, names))
        expected, todo = (
            f"{file}:{name}: expected a trained model",
            f"npred train {file} --model {name}, or give the --set that it was trained with, in Python `settings`",
        )
        artifact = _last(pipeline, store, "train", name, expected, todo)
        plant, table = plants.resolve(*pipeline.of_plant), pipeline.train.table(name)
    elif overrides:
        cure = "leave out its settings"
        raise ConfigError(f"{spec}: expected PIPELINE:MODEL, whose keys can be set, got a result; {cure}")
    else:
        artifact, plant, table = store.find(name), None, None
    manifest, epoch = artifact.verify().manifest, asked.epoch
    if (model := manifest.question.model) is None:
        raise ConfigError(f"{spec}: expected a trained model, got {artifact.name}; see npred ls")
    if epoch is not None and f"snapshot-{epoch}.safetensors" not in manifest.files:
        raise ConfigError(f"{spec}: expected a snapshot of epoch {epoch}, got none; add it to train.{model}.snapshots")
    return Stored(artifact.folder, model, epoch, plant or _named(artifact, spec), table)


def _of_default(name: str) -> bool:
    """True if a name is that of a network: a built-in one, or one of the default pipeline."""
    if name in config.Train().names:
        return True
    try:
        return name.isidentifier() and name in config.load(defaults.pipeline("")).train.named
    except ConfigError:
        return False


def load_data(spec: str, root: Path | None = None, overrides: list[str] | None = None) -> Artifact:
    """The data meant by `PIPELINE`, an artifact's folder or key, or `generate` for the latest; verified.

    Raises ConfigError where there is none, StoreError for corrupt files.
    """
    store = Store(root or defaults.store())
    if not spec.endswith(".toml") and spec not in defaults.shipped():
        artifact = store.find(spec).verify()
        if artifact.manifest.question.stage != "generate":
            raise ConfigError(f"{spec}: expected data, got {artifact.name}; see npred ls for generate/…")
        return artifact
    pipeline = config.load(defaults.pipeline(spec), overrides)
    return _last(pipeline, store, "generate", None, f"{spec}: expected data", f"npred generate {spec}").verify()


def held_out(stored: Stored, store: Store) -> Dataset:
    """The held-out rows of the data that a network was trained on. Raises ConfigError where the store lacks them."""
    source = store.find(str(stored.folder)).manifest.question.inputs["generate"]
    data = store.get("generate", source.key)
    if data is None:
        raise ConfigError(f"export: expected the model's data {source.key[:12]} in {store.root}, got none; generate it")
    return shards.survey(data.verify().folder / "data.h5").subset(test=True)


def _last(pipeline: config.Pipeline, store: Store, stage: str, model: str | None, expected: str, todo: str) -> Artifact:
    """The result of a pipeline's stage. Raises ConfigError where the store has none."""
    step = Planner(pipeline, store, "cpu").plan(nodes(pipeline, [stage], only=model))[-1]
    if step.artifact is None:
        raise ConfigError(f"{expected} in {store.root}, got none ({step.reason}); run {todo}")
    return step.artifact


def _named(artifact: Artifact, spec: str) -> Plant:
    """The built-in plant of an artifact. Other plants are code: run when a pipeline names them, never else."""
    asked = artifact.manifest.question.config.get("plant")
    named = asked if isinstance(asked, dict) else {}
    name, parameters = named.get("name"), named.get("parameters")
    values = parameters if isinstance(parameters, dict) else {}
    plant = plants.resolve(str(name), values) if plants.is_builtin(name) else None
    if plant is None or identity(plant) != named:
        cure = "use PIPELINE:MODEL"
        raise ConfigError(f"{spec}: expected a built-in plant, got {name!r} of another npred or of a file; {cure}")
    return plant
