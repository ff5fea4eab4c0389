"""The store: what is in it is whole and unchanged, or it is an error that names the file."""

import errno
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from conftest import process_environment
from store_samples import made_at, put, question, tree

from npred.base.errors import ConfigError, StoreError
from npred.lab.store import MARKER, Artifact, Manifest, ResultInput, Store
from npred.lab.store.manifest import Question, canonical

HELD = "0" * 64
HOLD = """
import sys
from pathlib import Path
from npred.lab.store import Store
with Store(Path(sys.argv[1])).lock("train", "0" * 64):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def test_a_forced_rerun_keeps_the_old_result_until_the_new_one_is_there(store: Store, monkeypatch):
    """To remove the old one takes time, in which a process may be killed."""
    old = put(store)

    def killed(path, ignore_errors=False):
        if path.name.endswith(".removed") and path.exists():
            raise KeyboardInterrupt

    draft = store.root / ".tmp" / "new"
    shutil.copytree(old.folder, draft)
    monkeypatch.setattr(shutil, "rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        store.commit(draft, old.manifest.question, "tests")
    monkeypatch.undo()
    assert store.get(old.manifest.question.stage, old.manifest.key).verify() and not draft.exists()


def test_golden_key():
    config = '{"D":1.0,"box":[1,2.5],"name":"ε"}'
    text = f'{{"config":{config},"inputs":{{"generate":"{"ab" * 32}"}},"model":null,"stage":"s","version":3}}'
    source = ResultInput(key="0" * 64, digest="ab" * 32)
    asked = Question(stage="s", version=3, model=None, config=json.loads(config), inputs={"generate": source})
    assert asked.key == hashlib.sha256(text.encode()).hexdigest()
    assert asked.key == "5cb4159737b32ca16b5875ee0f0e2e6f0b31db8e11c0381a57aaf4fd9001c933"


def test_a_key_does_not_depend_on_the_order_of_tables_nor_on_where_inputs_were_made():
    assert question(config={"lr": 1e-3, "seed": 0}).key == question().key
    assert question(inputs={"generate": ResultInput(key="9" * 64, digest="2" * 64)}).key == question().key


@pytest.mark.parametrize(
    "change",
    [
        {"stage": "evaluate"},
        {"version": 2},
        {"model": None},
        {"config": {"seed": 1, "lr": 1e-3}},
        {"config": {"seed": 0}},
        {"inputs": {}},
        {"inputs": {"generate": ResultInput(key="1" * 64, digest="3" * 64)}},
    ],
    ids=str,
)
def test_every_part_of_the_question_enters_the_key(change: dict[str, Any]):
    assert question(**change).key != question().key


def test_a_key_refuses_what_json_cannot_hold():
    with pytest.raises(ValueError, match="JSON"):
        canonical({"lr": float("nan")})


def test_what_was_put_is_what_is_got(store: Store):
    put(store)
    found = store.get("train", question().key)
    assert found is not None
    assert found.verify().result() == {"mse": 0.5}
    assert found.manifest.question == question()
    assert set(found.manifest.files) == {"data.bin", "more/figure.svg", "result.json"}
    assert found.manifest.files["data.bin"].sha256 == hashlib.sha256(b"payload").hexdigest()
    assert store.leftovers() == []
    assert store.get("train", "f" * 64) is None


def test_the_digest_depends_on_the_payload_only(store: Store):
    first = put(store).manifest
    again = put(store, question(version=2), pipeline="another").manifest
    other = put(store, question(version=3), data=b"Payload").manifest
    assert first.digest == again.digest != other.digest


@pytest.mark.parametrize("name", ["data.bin", "more/figure.svg", "result.json", "manifest.json"])
def test_a_flipped_bit_is_found_the_file_named_and_nothing_written(store: Store, name: str):
    folder = put(store).folder
    for position in (0, len((folder / name).read_bytes()) // 2):
        content = bytearray((folder / name).read_bytes())
        content[position] ^= 1
        (folder / name).write_bytes(content)
        before = tree(store.root)
        with pytest.raises(StoreError) as caught:
            Artifact.read(folder).verify()
        assert str(folder / name) in str(caught.value)
        assert "\n" not in str(caught.value)
        assert tree(store.root) == before
        content[position] ^= 1
        (folder / name).write_bytes(content)
    Artifact.read(folder).verify()


def test_a_digit_changed_anywhere_in_the_manifest_is_found(store: Store):
    path = put(store).folder / "manifest.json"
    text = path.read_text()
    for match in re.finditer(r"\d(?=[\d\",.])", text):
        changed = str((int(match.group()) + 1) % 10)
        path.write_text(text[: match.start()] + changed + text[match.end() :])
        with pytest.raises(StoreError):
            Manifest.read(path)


def test_a_missing_a_shortened_and_a_lengthened_file_are_found(store: Store):
    folder = put(store).folder
    for damage in (b"payl", b"payload and more", None):
        (folder / "data.bin").unlink()
        if damage is not None:
            (folder / "data.bin").write_bytes(damage)
        with pytest.raises(StoreError, match=re.escape(str(folder / "data.bin"))):
            Artifact.read(folder).verify()


def test_an_artifact_moved_to_another_key_is_found(store: Store):
    folder = put(store).folder
    folder.rename(folder.with_name("0" * 64))
    with pytest.raises(StoreError, match=r"manifest\.json"):
        store.get("train", "0" * 64)


def test_a_draft_that_fails_leaves_nothing(store: Store):
    with pytest.raises(RuntimeError), store.draft("train", "k") as folder:
        (folder / "half").write_text("x")
        raise RuntimeError
    assert tree(store.root) == {}
    assert store.leftovers() == []


def test_a_draft_does_not_see_what_a_killed_process_left(store: Store):
    left = store.root / ".tmp" / "train-k"
    left.mkdir(parents=True)
    (left / "half").write_text("x")
    with store.draft("train", "k") as folder:
        assert list(folder.iterdir()) == []


def test_nothing_is_in_place_before_the_payload_is_durable(store: Store, monkeypatch: pytest.MonkeyPatch):
    synced: list[Path] = []
    real, rename = os.fsync, Path.rename

    def fsync(descriptor: int) -> None:
        synced.append(Path(os.readlink(f"/proc/self/fd/{descriptor}")))
        real(descriptor)

    def checked(self: Path, target: Path) -> Path:
        written = {self, *self.rglob("*")}
        assert written <= set(synced)
        return rename(self, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "rename", checked)
    folder = put(store).folder
    assert synced[-1] == folder.parent


def test_a_second_commit_replaces_the_whole_result(store: Store):
    put(store)
    put(store, data=b"forced")
    found = store.get("train", question().key)
    assert found is not None
    assert (found.verify().folder / "data.bin").read_bytes() == b"forced"
    assert store.leftovers() == []


def test_find(store: Store):
    a, b = put(store), put(store, question(model="deeponet"))
    put(store, question(stage="generate", model=None))
    assert store.find(a.manifest.key[:9]).folder == a.folder
    assert store.find(f"train/{b.manifest.key[:9]}").folder == b.folder
    assert store.find("fno").folder == a.folder
    assert store.find("train").folder == b.folder  # the most recent
    assert store.find(str(a.folder)).folder == a.folder
    for nothing in (f"generate/{a.manifest.key[:9]}", "xyz", "train/", ""):
        with pytest.raises(ConfigError, match="expected one artifact"):
            store.find(nothing)


def test_an_ambiguous_prefix_lists_the_candidates(store: Store):
    artifacts = [put(store, question(version=version)) for version in range(1, 18)]
    digits = [artifact.manifest.key[0] for artifact in artifacts]
    twice = next(digit for digit in digits if digits.count(digit) > 1)
    with pytest.raises(ConfigError, match=f"train/{twice}.*, train/{twice}"):
        store.find(twice)


def test_only_folders_named_by_a_key_are_the_stores(store: Store):
    kept = put(store)
    (store.root / "notes" / "mine").mkdir(parents=True)
    torn = store.root / "train" / ("a" * 64)
    torn.mkdir()
    sound, broken = store.survey()
    assert [artifact.folder for artifact in sound] == [kept.folder]
    assert broken == [torn]


@pytest.fixture
def holder(store: Store):
    """Another process that holds the lock of train/k."""
    command = [sys.executable, "-c", HOLD, str(store.root)]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=process_environment(), **pipes) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_a_held_lock_names_its_holder(store: Store, holder: subprocess.Popen[str]):
    with pytest.raises(StoreError, match=f"process {holder.pid} on "), store.lock("train", HELD):
        pass
    with store.lock("train", "another"):
        pass


def test_a_lock_dies_with_its_holder(store: Store, holder: subprocess.Popen[str]):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    note = store.root / ".locks" / f"train-{HELD}.holder"
    with store.lock("train", HELD):
        assert json.loads(note.read_text())["pid"] == os.getpid()
    assert not note.exists()


def test_a_worker_forked_by_the_holder_does_not_keep_the_lock(store: Store):
    (up, ready), (read, go) = os.pipe(), os.pipe()
    with store.lock("train", "k"):
        worker = os.fork()
        if not worker:
            os.write(ready, b"!")
            os.read(read, 1)
            os._exit(0)
        os.read(up, 1)
        held = [os.readlink(entry) for entry in Path(f"/proc/{worker}/fd").iterdir()]
        os.write(go, b"!")
        os.waitpid(worker, 0)
    assert [name for name in held if name.endswith("train-k.lock")] == []


def test_waiting_tells_who_is_waited_for(store: Store, holder: subprocess.Popen[str]):
    told: list[str] = []

    def waiting(who: str) -> None:
        told.append(who)
        assert holder.stdin is not None
        holder.stdin.close()  # lets it go

    with store.lock("train", HELD, waiting):
        assert [str(holder.pid) in who for who in told] == [True]


def test_what_is_being_worked_on_is_not_deleted(store: Store, holder: subprocess.Popen[str]):
    draft = store.root / ".tmp" / f"train-{HELD}"
    draft.mkdir(parents=True)
    assert not store.delete(draft)
    assert draft.exists()
    kept, artifact = store.scratch("train", "1" * 64), put(store)
    kept.mkdir(parents=True)
    assert store.delete(kept)
    assert store.delete(artifact.folder)
    assert not kept.exists()
    assert not artifact.folder.exists()


def test_what_is_due_is_asked_again_under_the_lock(store: Store):
    artifact = put(store)

    def due(folder: Path) -> bool:
        with pytest.raises(StoreError, match="expected a free lock"), store.lock("train", folder.name):
            pass
        return False

    assert not store.delete(artifact.folder, due)
    assert artifact.verify().folder.exists()


def test_a_result_that_is_removed_while_the_store_is_read_is_none(store: Store, monkeypatch: pytest.MonkeyPatch):
    """Whether before its manifest is read or after."""
    kept, *gone = (put(store, question(version=version)) for version in (1, 2, 3))
    read = Artifact.read

    def removing(folder: Path) -> Artifact:
        if folder == gone[0].folder:
            store.discard(folder)
        found = read(folder)
        if folder == gone[1].folder:
            store.discard(folder)
        return found

    monkeypatch.setattr(Artifact, "read", removing)
    assert store.survey() == ([kept], [])


def test_a_store_that_cannot_be_written_is_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(StoreError, match="expected a store that can be written"),
        Store(tmp_path / "file").lock("train", "k"),
    ):
        pass


def test_made_is_the_time_of_the_manifest_so_that_a_copy_is_as_old_as_its_original(store: Store, tmp_path: Path):
    now = datetime.now(UTC)
    ages = {1: timedelta(days=3), 2: timedelta(days=1), 3: timedelta(days=2)}
    for version, age in ages.items():
        made_at(put(store, question(version=version)).folder, now - age)
    shutil.copytree(store.root, tmp_path / "copy")
    for number, path in enumerate(sorted((tmp_path / "copy").glob("train/*/manifest.json"))):
        os.utime(path, (number, number))
    copies = Store(tmp_path / "copy").artifacts()
    assert [a.manifest.question.version for a in copies] == [1, 3, 2]
    assert copies[0].made == (now - ages[1]).timestamp()
    assert Store(tmp_path / "copy").find("fno").manifest.question.version == 2


@pytest.mark.parametrize("moment", [None, datetime.now(UTC) + timedelta(days=9)])
def test_made_is_the_time_of_the_file_where_the_manifest_has_none_that_is_past(store: Store, moment: datetime | None):
    folder = made_at(put(store).folder, moment)
    os.utime(folder / "manifest.json", (1e9, 1e9))
    assert Artifact.read(folder).made == 1e9


def test_a_store_is_marked_with_its_first_result(store: Store):
    assert not store.marked
    put(store)
    assert store.marked and (store.root / MARKER).read_bytes() == b""


def test_a_new_an_empty_and_a_copied_store_are_adopted_a_folder_of_other_things_is_not(store: Store, tmp_path: Path):
    store.adopt()
    assert store.marked
    put(store)
    (store.root / MARKER).unlink()
    store.adopt()
    assert store.marked
    foreign, empty = Store(tmp_path / "foreign"), Store(tmp_path / "empty")
    (foreign.root / "train" / HELD).mkdir(parents=True)
    empty.root.mkdir()
    for other in (foreign, empty):
        other.adopt()
    assert (foreign.marked, empty.marked) == (False, True)
    (foreign.root / MARKER).symlink_to("train")
    assert not foreign.marked


def test_only_what_npred_names_is_deleted(store: Store, tmp_path: Path):
    """Not other files of .tmp and .scratch, not what a link leads to, not other depths."""
    artifact, elsewhere = put(store), tmp_path / "elsewhere"
    (elsewhere / HELD).mkdir(parents=True)
    names = (".tmp/mine", f".tmp/{HELD}", ".scratch/train-k", f"Train/{HELD}", f".git/{HELD}", f"train/{HELD}/{HELD}")
    for name in names:
        (store.root / name).mkdir(parents=True)
    (store.root / ".tmp" / f"train-{HELD}").write_text("a file")
    (store.root / "linked").symlink_to(elsewhere)
    (store.root / ".scratch" / f"train-{HELD}").symlink_to(elsewhere)
    assert store.leftovers() == []
    foreign = [*names, f".tmp/train-{HELD}", f"linked/{HELD}", f".scratch/train-{HELD}"]
    assert [name for name in foreign if store.owns(store.root / name) or store.delete(store.root / name)] == []
    assert all((store.root / name).exists() for name in foreign)
    shutil.rmtree(store.root / ".scratch")
    (elsewhere / f"train-{HELD}").mkdir()
    (store.root / ".scratch").symlink_to(elsewhere)
    assert store.leftovers() == [] and not store.delete(store.root / ".scratch" / f"train-{HELD}")
    assert store.delete(artifact.folder)


def test_what_a_removal_left_is_removed_under_the_lock_of_its_key(store: Store, holder: subprocess.Popen[str]):
    left = store.root / ".tmp" / f"train-{HELD}.removed"
    left.mkdir(parents=True)
    assert store.leftovers() == [left] and not store.delete(left)
    holder.kill()
    holder.wait()
    assert store.delete(left) and store.leftovers() == []


def test_where_a_full_disk_has_no_room_for_another_name_a_result_goes_from_where_it_is(store: Store, monkeypatch):
    def full(self: Path, target: Path) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    artifact = put(store)
    monkeypatch.setattr(Path, "rename", full)
    assert store.delete(artifact.folder) and not artifact.folder.exists()


def test_a_lock_works_where_its_note_cannot_be_written(store: Store, monkeypatch):
    def full(self: Path, text: str, encoding: str) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with (
        store.lock("train", HELD),
        pytest.raises(StoreError, match="held by another process"),
        store.lock("train", HELD),
    ):
        pass


def test_a_manifest_says_what_the_numbers_depend_on_beyond_the_question(store: Store, monkeypatch):
    """The same question under another mode of the libraries has the same key."""
    before = put(store).manifest
    monkeypatch.setenv("ATEN_CPU_CAPABILITY", "default")
    monkeypatch.setenv("MKL_CBWR", "COMPATIBLE")
    after = put(store).manifest
    assert (before.key, before.digest) == (after.key, after.digest)
    assert {"cpu", "cpu_features", "torch_kernels", "mkl_mode", "device"} <= before.circumstances.keys()
    assert before.circumstances["mkl_mode"] == "default" and after.circumstances["mkl_mode"] == "COMPATIBLE"
    assert "ATEN_CPU_CAPABILITY=default" in str(after.circumstances["arithmetic_settings"])
    assert "made" not in after.circumstances
