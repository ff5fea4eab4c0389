"""The commands that look after the store and the machine; gc plans first, and deletes with --yes."""

import os
import platform
import re
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, NamedTuple

from npred.base import defaults, devices
from npred.base.errors import ConfigError, NpredError, StoreError, disk_is_full, installed
from npred.base.registry import RESOLVERS
from npred.cli.options import Common, argument, flag
from npred.lab import config
from npred.lab.report.terminal.console import columns
from npred.lab.scheduler.cells import cells
from npred.lab.scheduler.plan import STAGES, Planner, nodes
from npred.lab.scheduler.retention import Kept, closure, remembered
from npred.lab.store import MARKER, Artifact, Store, claims, short
from npred.lab.store.manifest import NAME, versions

KEY = re.compile("[0-9a-f]{64}")
SHOWN = 4  # names of results on a line
PACKAGES = ("npred", "numpy", "torch", "h5py", "pydantic", "safetensors", "typer", "onnxruntime", "distributed")


class Waste(NamedTuple):
    """Something to delete, and why; of a sound result also the checksum of its manifest."""

    path: Path
    bytes: int
    reason: str
    checksum: str | None = None


def gc(
    options: Common,
    *,
    pipelines: Annotated[
        list[Path] | None, argument(None, "Pipelines whose results stay; by default all in pipeline/.")
    ] = None,
    set: Annotated[
        list[str] | None, flag("The --set of a sweep whose results stay too.", "--set", word="KEY=VALUES")
    ] = None,
    yes: Annotated[bool, flag("Delete the results that the plan names.", "--yes")] = False,
    device: Annotated[str, flag("Device of the runs whose results stay: auto, cpu, cuda or cuda:N.")] = "auto",
) -> None:
    """The plan of what to delete, and with `yes` the deletion: of results that no pipeline and no grid needs.

    Raises ConfigError where no pipeline says what stays, StoreError for a folder of other things, as a --store that was
    meant otherwise may be.
    """
    store = options.results
    if store.root.is_dir() and any(store.root.iterdir()) and not store.marked:
        raise StoreError(
            f"{store.root}: expected a store of npred, found no {MARKER} in it; if npred made its results, "
            f"npred run of one of their pipelines marks it, or touch {store.root / MARKER}"
        )
    plan = list(_plan(store, _kept(options, pipelines or [], set or [], device)))
    deleted = [str(path) for path in _delete(store, plan)] if yes else []
    rows = [{"path": str(waste.path), "bytes": waste.bytes, "reason": waste.reason} for waste in plan]
    options.show({"plan": rows, "deleted": deleted}, lambda: _table(plan, deleted, yes, options.console.width))


def _delete(store: Store, plan: list[Waste]) -> list[Path]:
    """Delete what can be: what a run uses stays. Where a full disk has no room for a lock, it is tried once more."""

    def deleted(waste: Waste) -> bool:
        def idle(path: Path) -> bool:  # and still what the plan was made for: a run may have put a new result there
            try:
                checksum = Artifact.read(path).manifest.checksum
            except StoreError:
                checksum = None
            return path.name not in claims.in_use(store.root) and checksum == waste.checksum

        return store.delete(waste.path, idle)

    paths, blocked = [], []
    for waste in plan:
        try:
            paths += [waste.path] if deleted(waste) else []
        except NpredError as error:
            if not disk_is_full(error):
                raise
            blocked.append(waste)
    return paths + [waste.path for waste in blocked if deleted(waste)]


def _kept(options: Common, pipelines: list[Path], sets: list[str], device: str) -> Kept:
    """The results that stay: those of published experiments, of the pipelines, and of the files that runs remember."""
    store = options.results
    paths = [defaults.pipeline(path) for path in pipelines] or sorted(defaults.PIPELINE.parent.glob("*.toml"))
    files = {path.resolve() for path in paths}
    roots = [root for root in remembered(store) if root.file not in files]
    if not paths and not roots:
        raise ConfigError(
            f"gc: expected pipelines whose results stay, found none in {defaults.PIPELINE.parent}/ and none that this "
            "store was run with; name them"
        )
    kept, device = Kept(), devices.resolve(device)
    for stage in RESOLVERS.names():
        if any(any(store.root.glob(pattern)) for pattern in (f"{stage}/*", f".scratch/{stage}-*")):  # else it is slow
            for planner in RESOLVERS.installed(stage).planners(store):
                kept.add(planner, planner.possible())
    for path in paths:
        for cell in [*cells(path, []), *(cells(path, sets) if sets else [])]:
            kept.add(Planner(cell.config, store, device), nodes(cell.config, STAGES))
    for root in roots:
        # To know what a file asks for its plant is run, which is code: not that of another user. Of a recording, and of
        # a file that is broken now, the results that it last used stay.
        try:
            if root.by_this_user and root.file.suffix == ".toml":
                pipeline = config.load(root.file)
                kept.add(Planner(pipeline, store, device), nodes(pipeline, STAGES))
                continue
        except NpredError as error:
            options.console.warn(f"{error}; the results that it last used stay")
        kept.keys.update(root.keys)
    return kept


def _plan(store: Store, kept: Kept) -> Iterator[Waste]:
    sound, broken = store.survey()
    stays = closure([artifact for artifact in sound if kept.holds(artifact)], sound)
    for artifact in sound:
        if artifact.manifest.key not in stays and store.owns(artifact.folder):
            reason = f"no pipeline needs it (made for {artifact.manifest.pipeline})"
            yield Waste(artifact.folder, artifact.size, reason, artifact.manifest.checksum)
    for folder in broken:
        if store.owns(folder) and folder.parent.name in (*STAGES, *RESOLVERS.names()):
            yield Waste(folder, _bytes(folder), "no sound manifest")
    for path in store.leftovers():
        resumed = path.parent.name == ".scratch" and kept.holds_checkpoint(path.name)
        if not resumed and path.exists():  # a run at work may just have removed it
            yield Waste(path, _bytes(path), "left by a run that ended early")


def _table(plan: list[Waste], deleted: list[str], yes: bool, width: int | None) -> str:
    if not plan:
        return "nothing to delete"
    rows = [[shortened(waste.path), f"{waste.bytes / 1e6:.1f} MB", waste.reason] for waste in plan]
    busy = f", {len(plan) - len(deleted)} in use, not deleted" if len(deleted) < len(plan) else ""
    total = f"{sum(waste.bytes for waste in plan) / 1e6:.1f} MB"
    last = f"deleted {len(deleted)}{busy}" if yes else f"{len(plan)} to delete, {total}; do it with --yes"
    return columns(["artifact", "size", "reason"], rows, width, numbers=["size"]) + f"\n{last}"


def shortened(path: Path) -> str:
    """`stage/key`, or `.scratch/stage-key`, with the key cut short; its manifest may be broken."""
    return f"{path.parent.name}/{KEY.sub(lambda key: short(key[0]), path.name)}"


def _bytes(folder: Path) -> int:
    total = 0
    for here, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):  # a run at work has just removed it
                status = Path(here, name).stat()
                total += status.st_size if stat.S_ISREG(status.st_mode) else 0
    return total


def doctor(options: Common) -> None:
    """Versions, devices, threads and the store, every file read: corrupt has changed bytes, incomplete fewer."""
    store = options.results
    artifacts, broken = store.survey()
    faulty = {*broken, *map(Path, _faults(options, artifacts))}
    lacking = {a.folder for a in artifacts if not all((a.folder / name).exists() for name in a.manifest.files)}
    lacking |= {folder for folder in broken if not (folder / NAME).exists()}
    above = next(path for path in [store.root, *store.root.absolute().parents] if path.exists())
    facts: dict[str, object] = {"python": platform.python_version(), "platform": platform.platform()}
    facts |= {key: value for key, value in devices.hardware("cpu").items() if key in ("cpu", "cores")}
    facts |= {"torch_threads": None, "gpus": []}
    if installed("torch"):
        import torch

        facts["torch_threads"] = torch.get_num_threads()
        facts["gpus"] = [torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())]
    facts |= {"compiler": versions()["compiler"], "packages": devices.packages(*PACKAGES)}
    facts["store"] = {
        "path": str(store.root),
        "writable": os.access(above, os.W_OK),
        "artifacts": len(artifacts),
        "bytes": sum(artifact.size for artifact in artifacts),
        "corrupt": len(faulty - lacking),
        "incomplete": len(lacking),
        "broken": [str(folder) for folder in broken],
        "leftovers": [str(path) for path in store.leftovers()],
    }
    options.show(facts, lambda: "\n".join(f"{name}: {_words(value)}" for name, value in facts.items()))


def _words(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_words(item)}" for key, item in value.items())
    if value is None or isinstance(value, bool):
        return {None: "absent", True: "yes", False: "no"}[value]
    return ", ".join(map(str, value)) or "none" if isinstance(value, list) else str(value)


def verify(options: Common) -> None:
    """Read every file of every result. Raises StoreError where one is not as it was written."""
    sound, broken = options.results.survey()
    faults = {str(folder): "no sound manifest" for folder in broken} | _faults(options, sound)
    made_with = {a.folder: a.manifest.circumstances for a in sound} | {folder: {} for folder in broken}
    table, entries = [], []
    for folder, circumstances in made_with.items():
        fault = faults.get(str(folder))
        state = "corrupt" if fault else "sound"
        table.append([shortened(folder), state, fault or ""])
        entries.append({"folder": str(folder), "state": state, "made_with": circumstances, "fault": fault})
    options.show_table({"artifacts": entries}, ["artifact", "state", "fault"], table)
    for name in dict.fromkeys(name for circumstances in made_with.values() for name in circumstances):
        results: dict[str, list[str]] = {}  # by the processor, say, or a mode of a library
        for artifact in sound:
            if value := artifact.manifest.circumstances.get(name):  # none where the stage does not need it
                results.setdefault(value, []).append(artifact.name)
        if len(results) > 1 and not options.json:
            options.console.out(f"made with different {name}:")
            for value, names in results.items():
                more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
                options.console.out(f"  {value}: {', '.join(names[:SHOWN])}{more}")
    if faults:
        first = next(iter(faults))
        raise StoreError(f"{options.store}: expected sound results, got {len(faults)} corrupt, as {first}; remove them")


def _faults(options: Common, artifacts: list[Artifact]) -> dict[str, str]:
    """The fault of each result, by folder; every file is read."""
    faults = {}
    with options.console.bar("verify", len(artifacts), "results") as bar:
        for artifact in artifacts:
            try:
                artifact.verify()
            except StoreError as error:
                faults[str(artifact.folder)] = str(error)
            bar.advance()
    return faults
