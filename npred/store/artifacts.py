"""The content-addressed store: a result is written aside, made durable, renamed into place, and never changed."""

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import Any, Self

from npred import documents
from npred.errors import ConfigError, StoreError
from npred.places import RESULT
from npred.store import durable, locks
from npred.store.keys import short
from npred.store.manifest import NAME, Manifest, Question, cure

_KEY = re.compile("[0-9a-f]{64}")  # whatever else lies under the root is not the store's to list or to remove


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
        """When it was written, in seconds since 1970."""
        return (self.folder / NAME).stat().st_mtime

    @property
    def size(self) -> int:
        """Bytes of payload."""
        return self.manifest.size

    def verify(self) -> Self:
        """This artifact, once every payload file is as it was written; else StoreError, naming the file."""
        self.manifest.verify(self.folder)
        return self

    def result(self) -> dict[str, Any]:
        """What the stage returned. Raises StoreError where its file is missing or no JSON object."""
        path = self.folder / RESULT
        try:
            return documents.table(path)
        except (OSError, ValueError) as error:
            raise StoreError(f"{path}: expected the answer as JSON, got: {error}; {cure(self.folder)}") from None


class Store:
    """`root/<stage>/<key>/` holds a result; `.tmp`, `.scratch` and `.locks` what is needed to make one."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def folder(self, stage: str, key: str) -> Path:
        """Where the result of a key is or will be."""
        return self.root / stage / key

    def scratch(self, stage: str, key: str) -> Path:
        """The folder that an interrupted stage finds again: its checkpoints."""
        return self.root / ".scratch" / f"{stage}-{key}"

    def get(self, stage: str, key: str) -> Artifact | None:
        """The artifact of a key, or None. Raises StoreError where something else lies in its place."""
        folder = self.folder(stage, key)
        return Artifact.read(folder) if folder.exists() else None

    def lock(self, stage: str, key: str, waiting: Callable[[str], None] | None = None) -> AbstractContextManager[None]:
        """The lock of a key; see npred.store.locks.held."""
        return locks.held(self.root / ".locks" / f"{stage}-{key}.lock", waiting)

    @contextmanager
    def draft(self, stage: str, key: str) -> Iterator[Path]:
        """An empty folder to write a result in, for the holder of the key's lock; what is left of it is removed."""
        folder = self.root / ".tmp" / f"{stage}-{key}"
        shutil.rmtree(folder, ignore_errors=True)  # a process that was killed left it
        folder.mkdir(parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def commit(self, draft: Path, question: Question, pipeline: str) -> Artifact:
        """Make a draft durable and rename it into place; a result already there steps aside (a forced rerun)."""
        manifest = Manifest.describe(question, pipeline, draft)
        (draft / NAME).write_text(manifest.text(), encoding="utf-8")
        return self.place(draft, manifest)

    def place(self, draft: Path, manifest: Manifest) -> Artifact:
        """`commit` for a draft that has its manifest.json, and is as that says."""
        durable.sync_tree(draft)
        target = self.folder(manifest.question.stage, manifest.key)
        durable.make(target.parent)
        before = self._aside(target)  # what takes time, its removal, comes when the new one is there
        draft.rename(target)
        durable.sync(target.parent)
        shutil.rmtree(before, ignore_errors=True)
        return Artifact(target, manifest)

    def survey(self) -> tuple[list[Artifact], list[Path]]:
        """Every result with a sound manifest, the most recent last, and the folders whose manifest is none.

        Raises StoreError where the store is no folder; one that does not exist yet is empty.
        """
        if self.root.exists() and not self.root.is_dir():
            raise StoreError(f"{self.root}: expected a store, a folder, got a file; choose another --store")
        sound, broken = [], []
        for folder in sorted(p for p in self.root.glob("[!.]*/*") if _KEY.fullmatch(p.name) and p.is_dir()):
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
        return sorted(path for place in (".tmp", ".scratch") for path in self.root.glob(f"{place}/*"))

    def find(self, reference: str) -> Artifact:
        """The artifact meant by `stage/prefix`, `prefix`, a stage or a model (its most recent), or a folder.

        Raises ConfigError where none or several match.
        """
        if (Path(reference) / NAME).is_file():
            return Artifact.read(Path(reference).resolve())
        everything = self.artifacts()
        named = [a for a in everything if reference in (a.manifest.question.stage, a.manifest.question.model)]
        if named:
            return named[-1]
        stage, _, prefix = reference.rpartition("/")
        found = [
            a for a in everything if a.manifest.key.startswith(prefix) and stage in ("", a.manifest.question.stage)
        ]
        if len(found) != 1 or not prefix:
            names = ", ".join(a.name for a in found[:4]) or "none"
            raise ConfigError(f"{reference}: expected one artifact of {self.root}, got {names}; see npred ls")
        return found[0]

    def delete(self, path: Path, due: Callable[[Path], bool] = lambda path: True) -> bool:
        """Remove a result, a draft or a checkpoint; False, and nothing done, while its key is being worked on.

        So too unless it is `due`, which is asked once nobody else can change it.
        """
        name = path.name if path.parent.name.startswith(".") else f"{path.parent.name}-{path.name}"
        stage, _, key = name.partition("-")
        try:
            with self.lock(stage, key):
                found = due(path)
                if found:
                    self.discard(path)
                return found
        except locks.HeldError:
            return False

    def discard(self, path: Path) -> None:
        """Remove a folder of the store whose key's lock is held."""
        shutil.rmtree(self._aside(path), ignore_errors=True)

    def _aside(self, path: Path) -> Path:
        """Rename a folder: a removal cut short must not leave half a result in the place of a whole one."""
        aside = self.root / ".tmp" / f"{path.parent.name.strip('.')}-{path.name}.removed"
        if path.exists():
            aside.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(aside, ignore_errors=True)
            path.rename(aside)
        return aside
