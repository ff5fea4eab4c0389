"""One artifact as one tar: its manifest first, then its files in order; the same artifact gives the same bytes.

Nothing in a tar is interpreted on the way in. Its first header gives the length of the manifest; with the manifest
every other byte but the payload is known beforehand, and anything else is refused: links, devices, other paths, more
or fewer bytes.
"""

import hashlib
import os
import re
import shutil
import tarfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import IO

from npred import json_files
from npred.errors import NpredError, StoreError, room_on_disk
from npred.store.artifacts import Artifact, Store
from npred.store.manifest import NAME, Manifest

_BLOCK = tarfile.BLOCKSIZE
_END = b"\0" * (2 * _BLOCK)
_FIRST = re.compile(rb"([a-z][a-z0-9_]{0,63})/([0-9a-f]{64})/manifest\.json\0")
_CHUNK = 2**20


def export(artifact: Artifact, path: Path) -> None:
    """Write the tar of an artifact, once its payload is verified. Raises StoreError for a corrupt one."""
    artifact.verify()
    partial = path.with_name(f"{path.name}.partial")
    try:
        with room_on_disk(path), partial.open("wb") as tar:
            for name, size in _members(artifact.manifest, (artifact.folder / NAME).stat().st_size):
                tar.write(_header(artifact.manifest, name, size))
                with (artifact.folder / name).open("rb") as file:
                    shutil.copyfileobj(file, tar, _CHUNK)
                tar.write(_padding(size))
            tar.write(_END)
            tar.flush()
            os.fsync(tar.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def load(
    store: Store, path: Path, omitted: Callable[[Manifest], Collection[str]],
    waiting: Callable[[str], None] | None = None,
) -> tuple[Artifact, bool]:  # fmt: skip
    """Bring the artifact of a tar into the store, whole or not at all; whether it is new there.

    `omitted` names the files that are left out, once they were checked as all others; what it raises refuses the tar.
    Raises StoreError for a file that `export` has not written or that was changed since, NpredError where the disk has
    no room for what the manifest announces or where the store has another answer to the same question.
    """
    if not path.is_file():
        raise StoreError(f"{path}: expected a tar of npred export-artifact, found no such file; check the path")
    with path.open("rb") as tar:
        manifest, content = _manifest(tar, path)
        try:
            left_out = omitted(manifest)
        except StoreError as error:
            raise StoreError(f"{path}: {error}") from None
        with store.lock(manifest.question.stage, manifest.key, waiting):
            there = store.get(manifest.question.stage, manifest.key)
            if there:
                return _same(there, manifest, omitted), False
            return _place(store, manifest, content, tar, left_out, path), True


def _same(there: Artifact, manifest: Manifest, omitted: Callable[[Manifest], Collection[str]]) -> Artifact:
    """The artifact in the store, if it is the same but for what is left out."""
    here = there.verify().manifest
    if here.without(omitted(here)).digest != manifest.without(omitted(manifest)).digest:
        ours, theirs = here.circumstances, manifest.circumstances
        differing = ", ".join(sorted(name for name in ours | theirs if ours.get(name) != theirs.get(name)))
        why = f" ({differing} differ)" if differing else ""
        what = f"expected none or the same bytes, got another answer to this question{why}"
        raise NpredError(f"{there.folder}: {what}; remove one of them")
    return there


def _place(
    store: Store, manifest: Manifest, content: bytes, tar: IO[bytes], left_out: Collection[str], path: Path
) -> Artifact:
    _fits(store, manifest, path)
    kept = manifest.without(left_out) if left_out else manifest
    with store.draft(manifest.question.stage, manifest.key) as folder, room_on_disk(store.root):
        (folder / NAME).write_bytes(kept.text().encode() if left_out else content)
        for name, size in list(_members(manifest, len(content)))[1:]:
            _expect(tar, _header(manifest, name, size), path, name)
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            _copy(tar, folder / name, manifest.files[name].sha256, size, path)
            _expect(tar, _padding(size), path, name)
        _expect(tar, _END, path, "the end")
        for name in left_out:
            (folder / name).unlink()
        return store.place(folder, kept)


def _manifest(tar: IO[bytes], path: Path) -> tuple[Manifest, bytes]:
    """The manifest that a tar begins with, and its bytes; the tar's length is as the manifest has it."""
    header = tar.read(_BLOCK)
    first = _FIRST.match(header)
    digits = header[124:135]
    size = int(digits, 8) if re.fullmatch(b"[0-7]{11}", digits) else json_files.LIMIT + 1
    if first is None or size > json_files.LIMIT:
        raise _refused(path, "its beginning")
    content = tar.read(size)
    try:
        manifest = Manifest.model_validate_json(content)
    except ValueError:
        raise _refused(path, NAME) from None
    if not manifest.consistent or header != _header(manifest, NAME, size) or _clash(manifest):
        raise _refused(path, NAME)
    _expect(tar, _padding(size), path, NAME)
    if os.fstat(tar.fileno()).st_size != _length(manifest, size):
        raise _refused(path, "its length")
    return manifest, content


def _clash(manifest: Manifest) -> bool:
    """True if a file's name is also a folder's."""
    folders = {parent.as_posix() for name in manifest.files for parent in Path(name).parents}
    return any(name in folders for name in [NAME, *manifest.files])


def _fits(store: Store, manifest: Manifest, path: Path) -> None:
    json_files.make_folder(store.root)
    free = shutil.disk_usage(store.root).free
    if manifest.size > free:
        raise NpredError(f"{path}: expected {manifest.size} free bytes in {store.root}, got {free}; free some")


def _members(manifest: Manifest, size: int) -> Iterator[tuple[str, int]]:
    yield NAME, size
    yield from ((name, payload.size) for name, payload in sorted(manifest.files.items()))


def _length(manifest: Manifest, size: int) -> int:
    members = _members(manifest, size)
    return sum(len(_header(manifest, name, n)) + n + len(_padding(n)) for name, n in members) + len(_END)


def _header(manifest: Manifest, name: str, size: int) -> bytes:
    """The blocks before a file: nothing in them but its path and its size."""
    info = tarfile.TarInfo(f"{manifest.question.stage}/{manifest.key}/{name}")
    info.size = size
    return info.tobuf(tarfile.GNU_FORMAT, "utf-8", "strict")


def _padding(size: int) -> bytes:
    return b"\0" * (-size % _BLOCK)


def _expect(tar: IO[bytes], expected: bytes, path: Path, what: str) -> None:
    if tar.read(len(expected)) != expected:
        raise _refused(path, what)


def _copy(tar: IO[bytes], target: Path, digest: str, size: int, path: Path) -> None:
    hashed, left = hashlib.sha256(), size
    with target.open("xb") as file:
        while chunk := tar.read(min(left, _CHUNK)):
            file.write(chunk)
            hashed.update(chunk)
            left -= len(chunk)
    if left or hashed.hexdigest() != digest:
        raise _refused(path, target.name)


def _refused(path: Path, what: str) -> StoreError:
    return StoreError(
        f"{path}: expected a tar as npred export-artifact wrote it, got other bytes at {what}; get the file again"
    )
