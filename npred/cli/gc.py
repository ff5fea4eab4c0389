"""`npred gc`: results that no pipeline needs, by age and size, planned first and deleted with --yes."""

import os
import re
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from npred import config, defaults
from npred.cli.options import Common
from npred.errors import ConfigError, NpredError, StoreError, disk_is_full
from npred.parallel import devices
from npred.pipeline import STAGES, Kept, Planner, closure, nodes
from npred.pipeline.cells import cells
from npred.pipeline.retention import GcRoot, remembered
from npred.registry import RESOLVERS
from npred.store import MARKER, Artifact, Store, claims, short
from npred.terminal.console import columns

UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
DAY = 86400.0
KEY = re.compile("[0-9a-f]{64}")


class Waste(NamedTuple):
    """Something to delete, and why; of a sound result also the checksum of its manifest."""

    path: Path
    bytes: int
    reason: str
    checksum: str | None = None

    def as_seen(self, path: Path) -> bool:
        """True if the path is still what the plan was made for: a run may have put a new result there."""
        try:
            return Artifact.read(path).manifest.checksum == self.checksum
        except StoreError:
            return self.checksum is None


def gc(
    options: Common, pipelines: list[Path], set: list[str], older: float, keep: str | None, device: str,
    yes: bool,
) -> None:  # fmt: skip
    """The plan of what to delete, and with `yes` the deletion: of what is older than so many days, the oldest first
    until the store has the size `keep`, but nothing that the pipelines and their grids need.

    Raises ConfigError where no pipeline says what stays.
    """
    limit, since = to_bytes(keep), time.time() - older * DAY
    _check_marker(options.results)
    plan = _plan(options.results, _kept(options, pipelines, set, device), limit, since)
    deleted = [str(path) for path in _delete(options.results, plan)] if yes else []
    rows = [{"path": str(waste.path), "bytes": waste.bytes, "reason": waste.reason} for waste in plan]
    options.show({"plan": rows, "deleted": deleted}, lambda: _table(plan, deleted, yes, options.console.width))


def _delete(store: Store, plan: list[Waste]) -> list[Path]:
    """Delete what can be. Where a disk has no room for a lock, the others make it: those are tried once more."""
    deleted, blocked = [], []
    for waste in plan:
        try:
            deleted += [waste.path] if _deleted(store, waste) else []
        except NpredError as error:
            if not disk_is_full(error):
                raise
            blocked.append(waste)
    return deleted + [waste.path for waste in blocked if _deleted(store, waste)]


def _deleted(store: Store, waste: Waste) -> bool:
    """True if it could be deleted: what a run makes or has taken stays."""
    return store.delete(waste.path, lambda path: path.name not in claims.in_use(store.root) and waste.as_seen(path))


def _plan(store: Store, kept: Kept, limit: int, since: float) -> list[Waste]:
    sound, broken = store.survey()
    stays = closure([a for a in sound if kept.holds(a) or a.made > since], sound)
    unneeded = [a for a in sound if a.manifest.key not in stays and store.owns(a.folder)]
    return [*_beyond(unneeded, sound, limit), *_broken(store, broken, kept, since)]


def _check_marker(store: Store) -> None:
    """Raise StoreError for a folder of other things, as a --store that was meant otherwise may be."""
    if store.root.is_dir() and any(store.root.iterdir()) and not store.marked:
        marker = store.root / MARKER
        raise StoreError(
            f"{store.root}: expected a store of npred, found no {MARKER} in it; if npred made its results, "
            f"npred run of one of their pipelines marks it, or touch {marker}"
        )


def _kept(options: Common, pipelines: list[Path], sets: list[str], device: str) -> Kept:
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
        _keep_remembered(options, kept, root, device)
    return kept


def _keep_remembered(options: Common, kept: Kept, root: GcRoot, device: str) -> None:
    """Keep what a pipeline file asks for that a run of this store took.

    What it last asked for stays where the file is broken now, and where another user ran it: to know what it asks for
    its plant is run, which is code.
    """
    try:
        if root.by_this_user and root.file.suffix == ".toml":  # of a recording what it asked for stays
            pipeline = config.load(root.file)
            kept.add(Planner(pipeline, options.results, device), nodes(pipeline, STAGES))
            return
    except NpredError as error:
        options.console.warn(f"{error}; what it last asked for stays")
    kept.keys.update(root.keys)


def _beyond(unneeded: list[Artifact], sound: list[Artifact], limit: int) -> Iterator[Waste]:
    """The oldest, until all that is left takes no more than `limit` bytes."""
    total = sum(artifact.size for artifact in sound)
    for artifact in unneeded:
        if total > limit:
            total -= artifact.size
            reason = f"no pipeline needs it (made for {artifact.manifest.pipeline})"
            yield Waste(artifact.folder, artifact.size, reason, artifact.manifest.checksum)


def _broken(store: Store, broken: list[Path], kept: Kept, since: float) -> Iterator[Waste]:
    for folder in (f for f in broken if store.owns(f) and f.parent.name in (*STAGES, *RESOLVERS.names())):
        yield Waste(folder, _bytes(folder), "no sound manifest")
    for path in store.leftovers():
        resumed = path.parent.name == ".scratch" and kept.holds_checkpoint(path.name)
        status = _stat(path)
        if not resumed and status and status.st_mtime <= since:
            yield Waste(path, _bytes(path), "left by a run that ended early")


def to_bytes(text: str | None) -> int:
    """The bytes meant by `500M` or `2.5G`, powers of ten; -1 for None. Raises ConfigError for other words."""
    if text is None:
        return -1
    match = re.fullmatch(r"(\d{1,9}\.?\d{0,9})([kMGT]?)B?", text)
    if match is None:
        raise ConfigError(f"--keep: expected a size as 500M or 2.5G, got {text!r}; write digits, then k, M, G or T")
    return round(float(match[1]) * UNITS[match[2]])


def _table(plan: list[Waste], deleted: list[str], yes: bool, width: int | None) -> str:
    if not plan:
        return "nothing to delete"
    rows = [[shortened(waste.path), f"{waste.bytes / 1e6:.1f} MB", waste.reason] for waste in plan]
    busy = f", {len(plan) - len(deleted)} in use and kept" if len(deleted) < len(plan) else ""
    total = f"{sum(waste.bytes for waste in plan) / 1e6:.1f} MB"
    last = f"deleted {len(deleted)}{busy}" if yes else f"{len(plan)} to delete, {total}; do it with --yes"
    return columns(["artifact", "size", "reason"], rows, width, numbers=["size"]) + f"\n{last}"


def shortened(path: Path) -> str:
    """`stage/key`, or `.scratch/stage-key`, with the key cut short; its manifest may be broken."""
    return f"{path.parent.name}/{KEY.sub(lambda key: short(key[0]), path.name)}"


def _bytes(folder: Path) -> int:
    files = (_stat(Path(here, name)) for here, _, names in os.walk(folder) for name in names)
    return sum(status.st_size for status in files if status and stat.S_ISREG(status.st_mode))


def _stat(path: Path) -> os.stat_result | None:
    """None for what a run at work has just removed."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None
