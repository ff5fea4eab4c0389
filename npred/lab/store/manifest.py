"""A result's manifest.json: the question, whose digest is its key, the digests of the answer, and where it was made.

The same question has the same key on every machine.
"""

import hashlib
import json
import os
import platform
import stat
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import cache, lru_cache
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from npred.base import json_files
from npred.base.devices import arithmetic, packages
from npred.base.errors import StoreError
from npred.kernels import compiler

NAME = "manifest.json"
MADE, SECONDS = "made", "seconds"  # in the provenance: when, and how long the run took that ended with it
SHORT = 12  # digits of a key, enough for people
PARTIAL = ".nfs"  # how NFS calls a file that was removed while somebody had it open
_ENCODER = json.JSONEncoder(
    sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False, check_circular=False, default=vars
)


def canonical(value: object) -> str:
    """JSON with sorted keys and no spaces; a part of a manifest as its table. Raises ValueError for NaN, infinity."""
    return _ENCODER.encode(value)


def sha256(value: object) -> str:
    """The sha256 of a value's canonical JSON, in hexadecimal."""
    return hashlib.sha256(canonical(value).encode()).hexdigest()


def short(key: str) -> str:
    """The first digits of a key."""
    return key[:SHORT]


@lru_cache(maxsize=1024)
def inside(name: str) -> str:
    """The name, if it is a plain relative path to a file that may lie beside a manifest; else ValueError."""
    path = PurePosixPath(name)
    plain = name.isprintable() and "\\" not in name and 0 < len(name.encode()) <= 200
    hidden = any(part == ".." or part.startswith(PARTIAL) for part in path.parts)
    if not plain or hidden or path.is_absolute() or path.as_posix() != name or name in (".", NAME):
        raise ValueError("expected a relative path inside the artifact")
    return name


@lru_cache(maxsize=1024)
def printable(text: str) -> str:
    """The text, if a terminal shows it as it is, on one line; else ValueError."""
    if not text.isprintable():
        raise ValueError("expected printable characters")
    return text


Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Word = Annotated[str, Field(pattern="^[a-z][a-z0-9_]{0,63}$")]
Name = Annotated[str, AfterValidator(inside)]
Line = Annotated[str, AfterValidator(printable)]


class ManifestPart(BaseModel):
    """A part of a manifest: frozen, and an unknown field is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Payload(ManifestPart):
    """One file of a result."""

    sha256: Digest
    size: Annotated[int, Field(ge=0, le=2**60)]


class ResultInput(ManifestPart):
    """An input of a result: the digest enters its key, the artifact's key says where it came from."""

    key: Digest
    digest: Digest


class Question(ManifestPart):
    """All that determines a result; `key` is its sha256."""

    stage: Word
    version: int
    model: Word | None
    config: dict[str, Any]
    inputs: dict[Line, ResultInput]

    @property
    def key(self) -> str:
        """The sha256 that names the artifact, of the inputs no more than their digests."""
        digests = {name: source.digest for name, source in self.inputs.items()}
        question = {"stage": self.stage, "version": self.version, "model": self.model, "config": self.config}
        return sha256(question | {"inputs": digests})


class Manifest(ManifestPart):
    """A question and the digests of its answer.

    `digest` covers the payload only and is what keys downstream use: an equal answer to another question stops reruns
    from spreading. `pipeline` and `provenance` enter neither. `checksum` covers all the other fields.
    """

    key: Digest
    question: Question
    files: dict[Name, Payload]
    digest: Digest
    pipeline: Line
    provenance: dict[Line, Line | None]
    checksum: Digest

    @classmethod
    def describe(
        cls, question: Question, pipeline: str, folder: Path, device: str = "cpu", seconds: float | None = None
    ) -> Self:
        """The manifest of the files in a folder, subfolders included, made now, on this machine and this device."""
        sizes = sorted(_files(folder))
        files = {name: {"sha256": json_files.sha256(folder / name), "size": size} for name, size in sizes}
        origin = {MADE: datetime.now(UTC).isoformat(), "python": platform.python_version()}
        origin |= {} if seconds is None else {SECONDS: f"{seconds:.3f}"}
        origin |= {"platform": platform.platform()} | versions() | arithmetic(device)
        fields = {
            "key": question.key,
            "question": question.model_dump(),
            "files": files,
            "digest": sha256(files),
            "pipeline": pipeline,
            "provenance": origin,  # no part of the key or of the digest
        }
        return cls.model_validate(fields | {"checksum": sha256(fields)})

    @classmethod
    def read(cls, path: Path) -> Self:
        """The manifest in a file. Raises StoreError, naming the file, unless it is as it was written, at its place."""
        try:
            manifest = cls.model_validate_json(json_files.read(path))
            checksum = sha256({name: value for name, value in manifest if name != "checksum"})
        except FileNotFoundError:
            raise StoreError(f"{path}: expected a manifest, found none; {cure(path.parent)}") from None
        except (OSError, ValueError, RecursionError):  # also for a number or a nesting that no configuration has
            raise StoreError(f"{path}: expected a manifest, got something else; {cure(path.parent)}") from None
        if checksum != manifest.checksum or manifest.key != path.parent.name:
            raise StoreError(f"{path}: expected the manifest as it was written, got changed bytes; {cure(path.parent)}")
        return manifest

    @property
    def circumstances(self) -> dict[str, str | None]:
        """All that the numbers may depend on beyond the question: versions, processor, modes of the libraries."""
        return {name: value for name, value in self.provenance.items() if name not in (MADE, SECONDS)}

    def verify(self, folder: Path) -> None:
        """Raise StoreError, naming the file, unless the folder holds the payload as it was written and nothing else."""
        sizes = dict(_files(folder))
        for name, payload in self.files.items():
            path = folder / name
            if name not in sizes:
                raise StoreError(f"{path}: expected a file of {payload.size} bytes, found none; {cure(folder)}")
            got = f"{sizes[name]} bytes" if sizes[name] != payload.size else json_files.sha256(path)
            if got != payload.sha256:
                recorded = f"sha256 {payload.sha256[:12]} in {payload.size} bytes"
                raise StoreError(f"{path}: expected {recorded}, got {got[:32]}: the file is corrupt; {cure(folder)}")
        more = sorted(sizes.keys() - self.files.keys())
        if more:
            raise StoreError(f"{folder / more[0]}: expected no such file in a result, found it; move it elsewhere")


def cure(folder: Path) -> str:
    """The advice on a corrupt artifact."""
    return f"remove {folder} and run again"


@cache
def versions() -> dict[str, str | None]:
    """The versions that a result's bytes may depend on."""
    return packages("npred", "numpy", "torch") | {"compiler": compiler.version()}


def _files(folder: Path) -> Iterator[tuple[str, int]]:
    """Path and size of each regular file below a folder, manifest.json aside; links, to files or folders, are none."""
    for here, _, names in os.walk(folder):
        for name in names:
            path = Path(here, name)
            status = path.lstat()
            if stat.S_ISREG(status.st_mode) and path != folder / NAME and not name.startswith(PARTIAL):
                yield path.relative_to(folder).as_posix(), status.st_size
