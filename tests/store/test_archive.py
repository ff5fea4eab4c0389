"""An artifact as a tar: the same bytes each time, and nothing comes in but what export wrote."""

import io
import os
import tarfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from store_samples import put, question, tree

from npred import json_files
from npred.errors import NpredError, StoreError
from npred.store import Artifact, Manifest, Store, archive
from npred.store.manifest import sha256


@pytest.fixture
def artifact(tmp_path: Path) -> Artifact:
    return put(Store(tmp_path / "mine"))


@pytest.fixture
def tar(artifact: Artifact, tmp_path: Path) -> Path:
    archive.export(artifact, tmp_path / "a.tar")
    return tmp_path / "a.tar"


def nothing(manifest: Manifest) -> tuple[()]:
    """Nothing is left out."""
    return ()


def forged(path: Path, members: list[tuple[tarfile.TarInfo, bytes]]) -> Path:
    """A tar as other programs write it."""
    with tarfile.open(path, "w", format=tarfile.GNU_FORMAT) as made:
        for info, content in members:
            info.size = len(content)
            made.addfile(info, io.BytesIO(content))
    return path


def signed(fields: dict[str, Any]) -> dict[str, Any]:
    """The fields of a manifest with the checksum that they need."""
    return fields | {"checksum": sha256({key: value for key, value in fields.items() if key != "checksum"})}


def refused(tmp_path: Path, tar: Path) -> None:
    """Nothing of it may be left in the store, and nothing outside of it."""
    before = tree(tmp_path)
    with pytest.raises(StoreError, match="expected a tar as npred export-artifact wrote it"):
        archive.load(Store(tmp_path / "theirs"), tar, nothing)
    after = {name: content for name, content in tree(tmp_path).items() if not name.endswith(".lock")}
    assert after == before


def test_there_and_back(artifact: Artifact, tar: Path, tmp_path: Path):
    theirs = Store(tmp_path / "theirs")
    found, new = archive.load(theirs, tar, nothing)
    assert new
    assert {p.name: p.read_bytes() for p in found.folder.rglob("*") if p.is_file()} == {
        p.name: p.read_bytes() for p in artifact.folder.rglob("*") if p.is_file()
    }
    assert found.verify().manifest == artifact.manifest
    assert theirs.leftovers() == []
    assert archive.load(theirs, tar, nothing) == (found, False)
    archive.export(found, tmp_path / "b.tar")
    assert (tmp_path / "b.tar").read_bytes() == tar.read_bytes()


def test_what_is_left_out_is_checked_and_not_there(artifact: Artifact, tar: Path, tmp_path: Path):
    """The rest is a sound result of the same key; with or without it, it is the same one."""

    def figures(manifest: Manifest) -> set[str]:
        return {name for name in manifest.files if name.endswith(".svg")}

    theirs = Store(tmp_path / "theirs")
    found, new = archive.load(theirs, tar, figures)
    assert new and set(found.verify().manifest.files) == {"data.bin", "result.json"}
    assert found.manifest.key == artifact.manifest.key and found.manifest.made == artifact.manifest.made
    assert archive.load(theirs, tar, figures) == (found, False)
    assert archive.load(Store(tmp_path / "mine"), tar, figures) == (artifact, False)
    content = tar.read_bytes()
    tar.write_bytes(content.replace(b"<svg/>", b"<SVG/>"))
    with pytest.raises(StoreError, match=r"got other bytes at figure\.svg"):
        archive.load(Store(tmp_path / "others"), tar, figures)


def test_what_refuses_a_manifest_names_the_file(tar: Path, tmp_path: Path):
    def refusing(manifest: Manifest) -> tuple[()]:
        raise StoreError("expected other names")

    with pytest.raises(StoreError, match=r"a\.tar: expected other names"):
        archive.load(Store(tmp_path / "theirs"), tar, refusing)
    assert Store(tmp_path / "theirs").artifacts() == []


def test_other_programs_can_read_it(artifact: Artifact, tar: Path, tmp_path: Path):
    with tarfile.open(tar) as opened:
        assert all(member.isreg() and member.mtime == 0 for member in opened)
        opened.extractall(tmp_path / "x", filter="data")
    assert Artifact.read(tmp_path / "x" / "train" / artifact.manifest.key).verify().result() == {"mse": 0.5}


@settings(max_examples=150)
@given(data=st.data())
def test_no_byte_of_a_tar_can_be_changed_added_or_dropped(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
):
    folder = tmp_path_factory.mktemp("tar")
    archive.export(put(Store(folder / "mine")), folder / "a.tar")
    content = (folder / "a.tar").read_bytes()
    at = data.draw(st.integers(0, len(content) - 1))
    some = data.draw(st.binary(max_size=3))
    more = data.draw(st.integers(0, 3))
    changed = content[:at] + some + content[at + more :]
    if changed == content:
        return
    (folder / "a.tar").write_bytes(changed)
    with pytest.raises(StoreError):
        archive.load(Store(folder / "theirs"), folder / "a.tar", nothing)
    assert Store(folder / "theirs").survey() == ([], [])


@pytest.mark.parametrize("name", ["../escaped", "/tmp/escaped", "x/../../escaped", "data.bin/../../../escaped"])
def test_a_path_that_leads_out_is_refused(artifact: Artifact, tmp_path: Path, name: str):
    folder = f"train/{artifact.manifest.key}"
    manifest = tarfile.TarInfo(f"{folder}/manifest.json"), (artifact.folder / "manifest.json").read_bytes()
    out = tarfile.TarInfo(f"{folder}/{name}"), b"payload"
    refused(tmp_path, forged(tmp_path / "bad.tar", [manifest, out]))


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE, tarfile.DIRTYPE])
def test_what_is_no_plain_file_is_refused(artifact: Artifact, tar: Path, tmp_path: Path, kind: bytes):
    with tarfile.open(tar) as opened:
        members = [(m, opened.extractfile(m).read()) for m in opened]  # type: ignore[union-attr]
    members[1][0].type, members[1][0].linkname = kind, "/etc/passwd"
    refused(tmp_path, forged(tmp_path / "bad.tar", [(members[1][0], b""), *members]))
    refused(tmp_path, forged(tmp_path / "bad.tar", [members[0], (members[1][0], b""), *members[2:]]))


@pytest.mark.parametrize(
    "name",
    ["../escaped", "/etc/escaped", "a\\b", "a//b", "", ".", "manifest.json", "a\nb", "x" * 201, ".nfs1", "a/.nfs1"],
)
def test_a_manifest_with_such_a_name_is_none(artifact: Artifact, name: str):
    fields = artifact.manifest.model_dump()
    fields["files"][name] = fields["files"].pop("data.bin")
    fields["digest"] = sha256(fields["files"])
    with pytest.raises(ValueError, match="files"):
        Manifest.model_validate(signed(fields))


@pytest.mark.parametrize("path", ["pipeline", "provenance", "provenance numpy", "question inputs"])
def test_a_manifest_that_would_write_over_a_terminal_is_none(artifact: Artifact, path: str):
    fields = artifact.manifest.model_dump()
    *parents, last = path.split()
    table = fields[parents[0]] if parents else fields
    strange = "x\x1b[2J\ny"
    table[last] = {strange: next(iter(table[last].values()))} if isinstance(table[last], dict) else strange
    with pytest.raises(ValueError, match="expected printable characters"):
        Manifest.model_validate(signed(fields))


def test_what_the_manifest_announces_must_fit_on_the_disk(tar: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(archive.shutil, "disk_usage", lambda path: type("Usage", (), {"free": 10}))
    with pytest.raises(NpredError, match=r"expected \d+ free bytes in .*, got 10; free some"):
        archive.load(Store(tmp_path / "theirs"), tar, nothing)
    assert Store(tmp_path / "theirs").survey() == ([], [])


def test_another_answer_to_the_same_question_is_not_replaced(tar: Path, tmp_path: Path, monkeypatch):
    theirs = Store(tmp_path / "theirs")
    kept = put(theirs, data=b"another")
    with pytest.raises(NpredError, match="got another answer to this question; remove one"):
        archive.load(theirs, tar, nothing)
    monkeypatch.setenv("MKL_CBWR", "COMPATIBLE")
    kept = put(theirs, data=b"another")
    with pytest.raises(NpredError, match=r"another answer to this question \(mkl_mode differ\)"):
        archive.load(theirs, tar, nothing)
    assert json_files.sha256(kept.folder / "data.bin") == kept.manifest.files["data.bin"].sha256


def test_a_corrupt_result_is_not_exported(artifact: Artifact, tmp_path: Path):
    (artifact.folder / "data.bin").write_bytes(b"Payload")
    with pytest.raises(StoreError, match=r"data\.bin"):
        archive.export(artifact, tmp_path / "a.tar")
    assert list(tmp_path.glob("*.tar*")) == []


def test_what_is_no_file_is_one_line(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    for name in ("none.tar", ".", "pipe"):
        with pytest.raises(StoreError, match="found no such file"):
            archive.load(Store(tmp_path / "theirs"), tmp_path / name, nothing)


def test_names_longer_than_a_tar_header_come_back(tmp_path: Path):
    mine, asked, name = Store(tmp_path / "mine"), question(), "deep/" * 20 + "shard-ε.h5"
    with mine.draft(asked.stage, asked.key) as folder:
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_bytes(b"x" * 513)
        archive.export(mine.commit(folder, asked, "p"), tmp_path / "a.tar")
    found, _ = archive.load(Store(tmp_path / "theirs"), tmp_path / "a.tar", nothing)
    assert (found.verify().folder / name).read_bytes() == b"x" * 513
