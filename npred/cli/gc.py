"""`npred gc`: results that no pipeline needs, planned first and deleted with --yes."""

import os
import re
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, NamedTuple

from npred.base import defaults, devices
from npred.base.errors import ConfigError, NpredError, StoreError, disk_is_full
from npred.base.registry import RESOLVERS
from npred.cli.options import Common, argument, flag
from npred.lab import config
from npred.lab.report.terminal.console import columns
from npred.lab.scheduler.cells import cells
from npred.lab.scheduler.plan import STAGES, Planner, nodes
from npred.lab.scheduler.retention import Kept, closure, remembered
from npred.lab.store import MARKER, Artifact, Store, claims, short

KEY = re.compile("[0-9a-f]{64}")


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
