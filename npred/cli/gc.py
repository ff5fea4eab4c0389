"""What `npred gc` does: what no pipeline needs, by age and size, planned first and deleted when told to."""

import os
import re
import stat
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from npred import config, defaults
from npred.cli.options import Common
from npred.errors import ConfigError, NpredError, StoreError
from npred.parallel import devices
from npred.pipeline import STAGES, Kept, Planner, closure, nodes
from npred.store import MARKER, Artifact, Store, claims, durable, gc_roots, short
from npred.store.gc_roots import GcRoot
from npred.sweep import cells
from npred.terminal.console import columns

UNITS = {"": 1, "k": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
DAY = 86400.0
KEY = re.compile("[0-9a-f]{64}")


@dataclass(frozen=True)
class Wanted:
    """What stays: of these pipelines and their grids, younger than so many days, up to so many bytes in all."""

    pipelines: list[Path] | None
    set: list[str] | None
    older: float
    keep: str | None
    device: str


class Waste(NamedTuple):
    """Something to delete, and why; of a sound result also the checksum of its manifest."""

    path: Path
    bytes: int
    reason: str
    checksum: str | None = None

    def as_seen(self, path: Path) -> bool:
        """Whether the path is still what the plan was made for: a run may have put a new result there."""
        try:
            return Artifact.read(path).manifest.checksum == self.checksum
        except StoreError:
            return self.checksum is None


def gc(options: Common, wanted: Wanted, yes: bool) -> None:
    """The plan of what to delete, and with `yes` the deed. Raises ConfigError where no pipeline says what stays."""
    plan = _plan(options, wanted)
    deleted = [str(path) for path in _delete(options.results, plan)] if yes else []
    rows = [{"path": str(waste.path), "bytes": waste.bytes, "reason": waste.reason} for waste in plan]
    options.show({"plan": rows, "deleted": deleted}, lambda: _told(plan, deleted, yes, options.console.width))


def _delete(store: Store, plan: list[Waste]) -> list[Path]:
    """What could be deleted. Where a disk has no room for a lock, the others make it: those are tried once more."""
    deleted, blocked = [], []
    for waste in plan:
        try:
            deleted += [waste.path] if _deleted(store, waste) else []
        except NpredError as error:
            if not durable.is_full(error):
                raise
            blocked.append(waste)
    return deleted + [waste.path for waste in blocked if _deleted(store, waste)]


def _deleted(store: Store, waste: Waste) -> bool:
    """Whether it could be deleted: what a run makes or has taken stays."""
    return store.delete(waste.path, lambda path: path.name not in claims.in_use(store.root) and waste.as_seen(path))


def _plan(options: Common, wanted: Wanted) -> list[Waste]:
    store = options.results
    limit, since = size(wanted.keep), time.time() - wanted.older * DAY
    _check_marker(store)
    kept = _kept(options, wanted)
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


def _kept(options: Common, wanted: Wanted) -> Kept:
    store = options.results
    paths = wanted.pipelines or sorted(defaults.PIPELINE.parent.glob("*.toml"))
    named = {path.resolve() for path in paths}
    remembered = [root for root in gc_roots.registered(store.root) if root.file not in named]
    if not paths and not remembered:
        raise ConfigError(
            f"gc: expected pipelines whose results stay, found none in {defaults.PIPELINE.parent}/ and none that this "
            "store was run with; name them"
        )
    kept, device = Kept(), devices.resolve(wanted.device)
    for path in paths:
        for cell in [*cells(path, []), *(cells(path, wanted.set) if wanted.set else [])]:
            kept.add(Planner(cell.config, store, device), nodes(cell.config, STAGES))
    for root in remembered:
        _keep_known(options, kept, root, device)
    return kept


def _keep_known(options: Common, kept: Kept, known: GcRoot, device: str) -> None:
    """Keep what a pipeline file asks for that a run of this store took.

    What it last asked for stays where the file is broken now, and where another user ran it: to know what it asks for
    its plant is run, which is code.
    """
    try:
        if known.own:
            pipeline = config.load(known.file)
            kept.add(Planner(pipeline, options.results, device), nodes(pipeline, STAGES))
            return
    except NpredError as error:
        options.console.warn(f"{error}; what it last asked for stays")
    kept.keep(known.keys)


def _beyond(unneeded: list[Artifact], sound: list[Artifact], limit: int) -> Iterator[Waste]:
    """The oldest, until all that is left takes no more than `limit` bytes."""
    total = sum(artifact.size for artifact in sound)
    for artifact in unneeded:
        if total > limit:
            total -= artifact.size
            reason = f"no pipeline needs it (made for {artifact.manifest.pipeline})"
            yield Waste(artifact.folder, artifact.size, reason, artifact.manifest.checksum)


def _broken(store: Store, broken: list[Path], kept: Kept, since: float) -> Iterator[Waste]:
    for folder in (f for f in broken if store.owns(f) and f.parent.name in STAGES):
        yield Waste(folder, _bytes(folder), "no sound manifest")
    for path in store.leftovers():
        resumed = path.parent.name == ".scratch" and kept.holds_checkpoint(path.name)
        found = _stat(path)
        if not resumed and found and found.st_mtime <= since:
            yield Waste(path, _bytes(path), "left by a run that ended early")


def size(text: str | None) -> int:
    """The bytes meant by `500M` or `2.5G`, powers of ten; -1 for None. Raises ConfigError for other words."""
    if text is None:
        return -1
    found = re.fullmatch(r"(\d{1,9}\.?\d{0,9})([kMGT]?)B?", text)
    if found is None:
        raise ConfigError(f"--keep: expected a size as 500M or 2.5G, got {text!r}; correct it")
    return round(float(found[1]) * UNITS[found[2]])


def _told(plan: list[Waste], deleted: list[str], yes: bool, width: int | None) -> str:
    if not plan:
        return "nothing to delete"
    rows = [[_short(waste.path), f"{waste.bytes / 1e6:.1f} MB", waste.reason] for waste in plan]
    busy = f", {len(plan) - len(deleted)} in use and kept" if len(deleted) < len(plan) else ""
    total = f"{sum(waste.bytes for waste in plan) / 1e6:.1f} MB"
    last = f"deleted {len(deleted)}{busy}" if yes else f"{len(plan)} to delete, {total}; do it with --yes"
    return columns(["artifact", "size", "reason"], rows, width, numbers=["size"]) + f"\n{last}"


def _short(path: Path) -> str:
    """`stage/key`, or `.scratch/stage-key`, with the key cut short."""
    return f"{path.parent.name}/{KEY.sub(lambda found: short(found[0]), path.name)}"


def _bytes(folder: Path) -> int:
    files = (_stat(Path(here, name)) for here, _, names in os.walk(folder) for name in names)
    return sum(found.st_size for found in files if found and stat.S_ISREG(found.st_mode))


def _stat(path: Path) -> os.stat_result | None:
    """None for what a run at work has just removed."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None
