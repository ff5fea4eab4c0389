"""Trained models and data by name: `pipeline/paper.toml:deeponet@107` to verified files of the store."""

from pathlib import Path
from typing import NamedTuple

from npred import config, defaults, plants
from npred.errors import ConfigError
from npred.parallel import devices
from npred.pipeline.plan import Planner
from npred.pipeline.stage_registry import Node, networks, nodes
from npred.plants import Plant
from npred.store import Artifact, Store


class Stored(NamedTuple):
    """A trained model: folder, network, the epoch of a snapshot (None: the final weights), and the plant."""

    folder: Path
    model: str
    snapshot: int | None
    plant: Plant


def load_model(spec: str, root: Path | None = None) -> Stored:
    """The trained model meant by `PIPELINE:MODEL`, `MODEL` (of the default pipeline), an artifact's folder or key.

    Each may end in `@EPOCH`, for a snapshot. Raises ConfigError where there is none, StoreError for corrupt files.
    """
    store = Store(root or defaults.store())
    name, epoch = _split(spec)
    path, colon, model = name.rpartition(":")
    if colon or name in networks():
        artifact, plant = _of_pipeline(defaults.pipeline(path), model, store)
    else:
        artifact, plant = store.find(name), None
    return _stored(artifact.verify(), epoch, spec, plant)


def load_data(spec: str, root: Path | None = None) -> Artifact:
    """The data meant by `PIPELINE`, an artifact's folder or key, or `generate` for the latest; verified.

    Raises ConfigError where there is none, StoreError for corrupt files.
    """
    store = Store(root or defaults.store())
    if not spec.endswith(".toml") and spec not in defaults.shipped():
        artifact = store.find(spec).verify()
        if artifact.manifest.question.stage != "generate":
            raise ConfigError(f"{spec}: expected data, got {artifact.name}; see npred ls for generate/…")
        return artifact
    (step,) = Planner(config.load(defaults.pipeline(spec)), store, "cpu").plan([Node("generate", None, ())])
    if step.artifact is None:
        raise ConfigError(f"{spec}: expected data in {store.root}, got none ({step.reason}); run npred generate {spec}")
    return step.artifact.verify()


def _split(spec: str) -> tuple[str, int | None]:
    name, at, epoch = spec.rpartition("@")
    if not at:
        return spec, None
    if not epoch.isdigit():
        raise ConfigError(f"{spec}: expected an epoch after @, got {epoch!r}; for example deeponet@107")
    return name, int(epoch)


def _of_pipeline(path: Path, model: str, store: Store) -> tuple[Artifact, Plant]:
    pipeline = config.load(path)
    if model not in networks():
        raise ConfigError(f"{path}:{model}: expected {' or '.join(networks())} after the colon; name one of them")
    planner = Planner(pipeline, store, devices.resolve("cpu"))
    step = planner.plan(nodes(pipeline, ["train"], only=model))[-1]
    if step.artifact is None:
        todo = f"npred train {path} --model {model}"
        raise ConfigError(
            f"{path}:{model}: expected a trained model in {store.root}, got none ({step.reason}); run {todo}"
        )
    return step.artifact, plants.resolve(pipeline.plant, pipeline.parameters)


def _stored(artifact: Artifact, epoch: int | None, spec: str, plant: Plant | None) -> Stored:
    model = artifact.manifest.question.model
    if model is None:
        raise ConfigError(f"{spec}: expected a trained model, got {artifact.name}; see npred ls")
    if epoch is not None and f"snapshot-{epoch}.safetensors" not in artifact.manifest.files:
        raise ConfigError(f"{spec}: expected a snapshot of epoch {epoch}, got none; add it to train.{model}.snapshots")
    return Stored(artifact.folder, model, epoch, plant or _named(artifact, spec))


def _named(artifact: Artifact, spec: str) -> Plant:
    """The built-in plant of an artifact. Other plants are code: run when a pipeline names them, never else."""
    identity = artifact.manifest.question.config.get("plant")
    named = identity if isinstance(identity, dict) else {}
    name, parameters = named.get("name"), named.get("parameters")
    values = parameters if isinstance(parameters, dict) else {}
    plant = plants.resolve(str(name), values) if plants.is_builtin(name) else None
    if plant is None or plant.identity != named:
        raise ConfigError(
            f"{spec}: expected a built-in plant, got {name!r} of another npred or of a file; use PIPELINE:MODEL"
        )
    return plant
