"""The content-addressed store: a result is written aside, made durable, renamed into place, and never changed."""

import math
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any, Self

from npred.base import json_files
from npred.base.defaults import RESULT
from npred.base.errors import ConfigError, StoreError, disk_is_full, similar
from npred.base.registry import NETWORKS, STAGES
from npred.lab.store import claims
from npred.lab.store.manifest import MADE, NAME, SECONDS, Manifest, Question, cure, short

MARKER = ".npred-store"  # an empty file: without it nothing in a folder is npred's to delete
_LEFT = (".tmp", ".scratch")
_KEY = re.compile("[0-9a-f]{64}")  # whatever else lies under the root is not the store's to list or to remove
_OWN = re.compile(r"(?:(?:tmp|scratch)-)?([a-z][a-z0-9_]{0,63})-([0-9a-f]{64})(?:\.removed)?")


@dataclass(frozen=True)
class Artifact:
    """A result in the store: its folder and its manifest."""

    folder: Path
    manifest: Manifest

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The artifact of a folder; its payload is checked by `verify`. Raises StoreError for a bad manifest."""
        return cls(folder, Manifest.read(folder / NAME))

    @property
    def name(self) -> str:
        """`stage/key` with the key cut short, as people write it."""
        return f"{self.manifest.question.stage}/{short(self.manifest.key)}"

    @cached_property
    def made(self) -> float:
        """The time when it was made, in s since 1970, by the manifest, so that a copy is as old as its original.

        The time of the file counts where the manifest has none, or one that is still to come.
        """
        written = (self.folder / NAME).stat().st_mtime
        try:
            recorded = datetime.fromisoformat(self.manifest.provenance.get(MADE) or "").timestamp()
        except (ValueError, OverflowError):
            return written
        return written if recorded > time.time() else recorded

    @property
    def seconds(self) -> float | None:
        """How long the run took that ended with it, in s; None where the manifest has no such number."""
        try:
            seconds = float(self.manifest.provenance.get(SECONDS) or "nan")
        except ValueError:
            return None
        return seconds if 0 <= seconds < math.inf else None

    @property
    def size(self) -> int:
        """Bytes of payload."""
        return sum(payload.size for payload in self.manifest.files.values())

    def verify(self) -> Self:
        """This artifact, once every payload file is as it was written; else StoreError, naming the file."""
        self.manifest.verify(self.folder)
        return self

    def result(self) -> dict[str, Any]:
        """The stage's answer. Raises StoreError where its file is missing or no JSON object."""
        path = self.folder / RESULT
        try:
            return json_files.table(path)
        except (OSError, ValueError) as error:
            raise StoreError(f"{path}: expected the answer as JSON, got: {error}; {cure(self.folder)}") from None


class Store:
    """`root/<stage>/<key>/` holds a result; `.tmp`, `.scratch` and `.locks` serve to make one.

    `.npred-store` says that the folder is a store: only in such a one is anything deleted.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    @property
    def marked(self) -> bool:
        """True if the folder says that it is a store."""
        marker = self.root / MARKER
        return marker.is_file() and not marker.is_symlink()

    def adopt(self) -> None:
        """Mark a folder that is new, empty or holds results, copied ones say, if it can be written; not another one."""
        if not self.marked and (not self.root.exists() or not any(self.root.iterdir()) or self.artifacts()):
            self._mark()

    def _mark(self) -> None:
        with suppress(OSError):
            self.root.mkdir(parents=True, exist_ok=True)
            (self.root / MARKER).touch()

    def scratch(self, stage: str, key: str) -> Path:
        """The folder that an interrupted stage finds again: its checkpoints."""
        return self.root / ".scratch" / f"{stage}-{key}"

    def get(self, stage: str, key: str) -> Artifact | None:
        """The artifact of a key, or None. Raises StoreError where something else lies in its place."""
        folder = self.root / stage / key
        return Artifact.read(folder) if folder.exists() else None

    def lock(self, stage: str, key: str, waiting: Callable[[str], None] | None = None) -> AbstractContextManager[None]:
        """The lock of a key; see npred.lab.store.claims.held."""
        return claims.held(self.root / ".locks" / f"{stage}-{key}.lock", waiting)

    @contextmanager
    def draft(self, stage: str, key: str) -> Iterator[Path]:
        """An empty folder to write a result in, for the holder of the key's lock; an old one is removed."""
        folder = self.root / ".tmp" / f"{stage}-{key}"
        shutil.rmtree(folder, ignore_errors=True)  # left by a process that was killed
        folder.mkdir(parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def commit(
        self, draft: Path, question: Question, pipeline: str, device: str = "cpu", seconds: float | None = None
    ) -> Artifact:
        """Make a draft of a run of so many `seconds` durable, and rename it into place; an older result steps aside."""
        manifest = Manifest.describe(question, pipeline, draft, device, seconds)
        (draft / NAME).write_text(manifest.model_dump_json(indent=1) + "\n", encoding="utf-8")
        for path in [*draft.rglob("*"), draft]:
            json_files.sync(path)
        target = self.root / question.stage / manifest.key
        json_files.make_folder(target.parent)
        before = self._aside(target)  # what takes time, its removal, comes when the new one is there
        draft.rename(target)
        json_files.sync(target.parent)
        shutil.rmtree(before, ignore_errors=True)
        self._mark()
        return Artifact(target, manifest)

    def survey(self) -> tuple[list[Artifact], list[Path]]:
        """Every result with a sound manifest, the most recent last, and the folders whose manifest is none.

        Raises StoreError where the store is no folder; one that does not exist yet is empty.
        """
        if self.root.exists() and not self.root.is_dir():
            raise StoreError(f"{self.root}: expected a store, a folder, got a file; choose another --store")
        sound, broken = [], []
        for folder in sorted(self.root.glob("[!.]*/*"), key=str):
            if not _KEY.fullmatch(folder.name) or not folder.is_dir():
                continue
            try:
                artifact = Artifact.read(folder)
                sound.append((artifact.made, artifact))
            except (StoreError, FileNotFoundError):  # one that was removed meanwhile is none
                broken += [folder] if folder.exists() else []
        return [artifact for _, artifact in sorted(sound, key=itemgetter(0))], broken

    def artifacts(self) -> list[Artifact]:
        """Every result with a sound manifest, the most recent last."""
        return self.survey()[0]

    def leftovers(self) -> list[Path]:
        """Drafts and checkpoints of runs that ended early, or are still at work."""
        return sorted(path for place in _LEFT for path in self.root.glob(f"{place}/*") if self.owns(path))

    def owns(self, path: Path) -> bool:
        """True if a folder is one that npred makes, by its path and name, and no link leads to it."""
        folder, place = path.parent, path.parent.name
        ours = place in _LEFT or (not place.startswith(".") and _KEY.fullmatch(path.name))
        links = path.is_symlink() or folder.is_symlink()
        return bool(folder.parent == self.root and ours and _whose(path) and not links and path.is_dir())

    def find(self, reference: str) -> Artifact:
        """The artifact meant by `stage/prefix`, `prefix`, a stage or a trained model (its most recent), or a folder.

        Raises ConfigError where none or several match.
        """
        if (Path(reference) / NAME).is_file():
            return Artifact.read(Path(reference).resolve())
        everything = self.artifacts()
        asked = [(a, a.manifest.question) for a in everything]
        of_stage = [a for a, q in asked if reference == q.stage or (reference == q.model and q.stage == "train")]
        if of_stage:
            return of_stage[-1]
        stage, _, prefix = reference.rpartition("/")
        keyed = [a for a in everything if a.manifest.key.startswith(prefix)]
        matching = [a for a in keyed if stage in ("", a.manifest.question.stage)]
        if len(matching) != 1 or not prefix:
            names = ", ".join(a.name for a in matching[:4]) or "none"
            stored = {*STAGES, *NETWORKS.names(), *(q.model for _, q in asked if q.model)}
            todo = similar(reference, stored - {reference}) or "; see npred ls"
            raise ConfigError(f"{reference}: expected one artifact of {self.root}, got {names}{todo}")
        return matching[0]

    def delete(self, path: Path, due: Callable[[Path], bool] = lambda path: True) -> bool:
        """Remove a result, a draft or a checkpoint; False, and nothing done, while its key is being worked on.

        So too unless it is `due`, which is asked once nobody else can change it, and for what npred has not made.
        """
        whose = _whose(path)
        if whose is None:
            return False
        try:
            with self.lock(*whose):
                removable = self.owns(path) and due(path)
                if removable:
                    self.discard(path)
                return removable
        except claims.HeldError:
            return False

    def discard(self, path: Path) -> None:
        """Remove a folder of the store whose key's lock is held."""
        try:
            path = self._aside(path)
        except OSError as error:
            if not disk_is_full(error):
                raise  # a full disk may have no room for another name: then it goes from where it is
        shutil.rmtree(path, ignore_errors=True)

    def _aside(self, path: Path) -> Path:
        """Rename a folder: a removal cut short must not leave half a result under the name of a whole one."""
        name = path.name if path.parent.name in _LEFT else f"{path.parent.name}-{path.name}"
        aside = self.root / ".tmp" / f"{name.removesuffix('.removed')}.removed"
        if path.exists() and path != aside:
            aside.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(aside, ignore_errors=True)
            path.rename(aside)
        return aside


def _whose(path: Path) -> tuple[str, str] | None:
    """Stage and key of a folder, by its name; None for names that npred does not give."""
    name = path.name if path.parent.name in _LEFT else f"{path.parent.name}-{path.name}"
    match = _OWN.fullmatch(name)
    return (match[1], match[2]) if match else None
