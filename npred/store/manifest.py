"""What a manifest.json holds: the question, the digests of the answer, and where it was made."""

import platform
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from npred.devices import package
from npred.errors import StoreError
from npred.store.keys import key, sha256, sha256_file

NAME = "manifest.json"


class Record(BaseModel):
    """A part of a manifest: frozen, and an unknown field is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Payload(Record):
    """One file of a result."""

    sha256: str
    size: int


class Source(Record):
    """An input of a result: the digest enters its key, the artifact's key says where it came from."""

    key: str
    digest: str


class Question(Record):
    """What determines a result; `key` is its sha256."""

    stage: str
    version: int
    model: str | None
    config: dict[str, Any]
    inputs: dict[str, Source]

    @property
    def key(self) -> str:
        """The sha256 that names the artifact; see npred.store.keys.key."""
        digests = {name: source.digest for name, source in self.inputs.items()}
        return key(self.stage, self.version, self.model, self.config, digests)


class Manifest(Record):
    """A question and the digests of its answer.

    `digest` covers the payload only and is what keys downstream use: an equal answer to another question stops reruns
    from spreading. `pipeline` and `provenance` enter neither. `checksum` covers all the other fields.
    """

    key: str
    question: Question
    files: dict[str, Payload]
    digest: str
    pipeline: str
    provenance: dict[str, str | None]
    checksum: str

    @classmethod
    def describe(cls, question: Question, pipeline: str, folder: Path) -> Self:
        """The manifest of the files in a folder, subfolders included."""
        files = _payloads(folder)
        fields = {
            "key": question.key,
            "question": question.model_dump(),
            "files": files,
            "digest": sha256(files),
            "pipeline": pipeline,
            "provenance": provenance(),
        }
        return cls.model_validate(fields | {"checksum": sha256(fields)})

    @classmethod
    def read(cls, path: Path) -> Self:
        """The manifest in a file. Raises StoreError, naming the file, unless every digest in it holds."""
        try:
            manifest = cls.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            raise StoreError(f"{path}: expected a manifest, found none; {cure(path.parent)}") from None
        except (OSError, ValidationError):
            raise StoreError(f"{path}: expected a manifest, got something else; {cure(path.parent)}") from None
        if not manifest.consistent or manifest.key != path.parent.name:
            raise StoreError(f"{path}: expected the manifest as it was written, got changed bytes; {cure(path.parent)}")
        return manifest

    @property
    def consistent(self) -> bool:
        """Whether checksum, digest and key all follow from the other fields."""
        fields = self.model_dump(exclude={"checksum"})
        return (self.checksum, self.digest, self.key) == (sha256(fields), sha256(fields["files"]), self.question.key)

    def text(self) -> str:
        """The JSON that `read` takes."""
        return self.model_dump_json(indent=1) + "\n"

    def verify(self, folder: Path) -> None:
        """Raise StoreError, naming the file, unless each payload file of the folder has its size and digest."""
        for name, payload in self.files.items():
            path = folder / name
            if not path.is_file():
                raise StoreError(f"{path}: expected a file of {payload.size} bytes, found none; {cure(folder)}")
            if path.stat().st_size != payload.size or (found := sha256_file(path)) != payload.sha256:
                got = found[:12] if path.stat().st_size == payload.size else f"{path.stat().st_size} bytes"
                wanted = f"sha256 {payload.sha256[:12]} in {payload.size} bytes"
                raise StoreError(f"{path}: expected {wanted}, got {got}: the file is corrupt; {cure(folder)}")


def cure(folder: Path) -> str:
    """What to do about a corrupt artifact."""
    return f"remove {folder} and run again"


def provenance() -> dict[str, str | None]:
    """Where a result was made; no part of any key or digest."""
    versions = {name: package(name) for name in ("npred", "numpy", "numba", "torch")}
    return {"python": platform.python_version(), "platform": platform.platform(), **versions}


def _payloads(folder: Path) -> dict[str, dict[str, Any]]:
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and path != folder / NAME)
    return {
        path.relative_to(folder).as_posix(): {"sha256": sha256_file(path), "size": path.stat().st_size}
        for path in paths
    }
