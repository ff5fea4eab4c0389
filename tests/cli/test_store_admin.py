"""`npred verify` and `doctor`, and stores that cannot be written."""

import shutil
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import fake_stages
import pytest
from conftest import Call, document, one_line
from store_samples import made_at

from npred.lab.store import Store


@pytest.fixture
def read_only(call: Call, tmp_path: Path) -> Iterator[Path]:
    """A store with every result of tiny.toml on a mount that cannot be written."""
    for bench in (7, 1000):
        call("run", "tiny.toml", "--store", "writable", "--set", f"bench.calls={bench}")
    folder = tmp_path / "read-only"
    folder.mkdir()
    if subprocess.run(["mount", "--bind", "-o", "ro", "writable", str(folder)], capture_output=True).returncode:
        pytest.skip("mounting takes more rights")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_verify_reads_every_file_of_every_result(call: Call):
    call("run", "tiny.toml")
    assert {row["state"] for row in document(call("verify", "--json"))["artifacts"]} == {"sound"}
    store = Store(Path("artifacts"))
    data, torn = store.find("fno").folder / "data.bin", store.find("evaluate").folder
    data.write_bytes(data.read_bytes()[:-1] + b"?")
    (torn / "manifest.json").write_text("{}")
    found = call("verify", "--json")
    assert found.exit_code == 4
    assert "got 2 corrupt" in found.stderr
    rows = {row["folder"]: row for row in document(found, 4)["artifacts"]}
    assert {f for f, row in rows.items() if row["state"] == "corrupt"} == {str(data.parent), str(torn)}
    assert str(data) in rows[str(data.parent)]["fault"]
    assert len(rows) == 6
    assert "Traceback" not in call("verify").output


@pytest.mark.parametrize("intruder", ["note.txt", "link", "more"])
def test_a_result_with_something_else_beside_it_or_behind_a_link_is_not_sound(call: Call, intruder: str):
    call("generate", "tiny.toml")
    folder = Store(Path("artifacts")).find("generate").folder
    if intruder == "link":
        (folder / "data.bin").rename("data.bin")
        (folder / "data.bin").symlink_to(Path("data.bin").absolute())
    else:
        (folder / intruder).write_text("x")
    assert call("verify").exit_code == 4


@pytest.mark.parametrize("command", ["ls", "verify", "doctor", "show", "gc tiny.toml", "status tiny.toml"])
def test_a_store_that_is_a_file_is_one_line_and_one_that_is_not_there_yet_is_empty(call: Call, command: str):
    Path("file").write_text("")
    line = one_line(call(*command.split(), "--store", "file"), 4)
    assert line == "error: file: expected a store, a folder, got a file; choose another --store"
    assert call(*command.split(), "--store", "nowhere").exit_code == (2 if command == "show" else 0)


def test_a_read_only_store_gives_hits_and_refuses_a_run_in_one_line(call: Call, read_only: Path):
    rows = document(call("run", "tiny.toml", "--store", read_only, "--json"))["stages"]
    assert {row["action"] for row in rows} == {"hit"}
    for command in ("status", "ls", "verify", "show"):
        pipeline = ["tiny.toml"] if command == "status" else []
        assert call(*command.split(), *pipeline, "--store", read_only).exit_code == 0
    line = one_line(call("run", "tiny.toml", "--set", "seed=1", "--store", read_only), 4)
    assert "expected a store that can be written and locked, got: Read-only file system" in line
    shutil.rmtree("writable/train")
    assert "Read-only file system" in one_line(call("gc", "tiny.toml", "--yes", "--store", read_only), 4)


def test_doctor_counts_corrupt_and_incomplete_results(call: Call):
    call("run", "tiny.toml")
    store = Store(Path("artifacts"))
    assert counts(call) == (6, 0, 0)
    data = store.find("fno").folder / "data.bin"
    data.write_bytes(data.read_bytes()[:-1] + b"?")
    (store.find("evaluate").folder / "data.bin").unlink()
    torn, changed = store.find("bench").folder, store.find("generate").folder
    (torn / "manifest.json").unlink()
    (changed / "manifest.json").write_text("{}")
    assert counts(call) == (4, 2, 2)
    assert "corrupt 2, incomplete 2" in call("doctor").stdout


def counts(call: Call) -> tuple[int, int, int]:
    """Results with a sound manifest, corrupt and incomplete ones, as doctor says."""
    facts = document(call("doctor", "--json"))["store"]
    return facts["artifacts"], facts["corrupt"], facts["incomplete"]


def test_what_the_numbers_depend_on_is_shown_where_it_differs(call: Call, monkeypatch: pytest.MonkeyPatch):
    """The same key on two machines, or under two modes of a library, and other bytes."""
    call("generate", "tiny.toml")
    assert "made with different" not in call("verify").stdout
    assert document(call("verify", "--json"))["artifacts"][0]["made_with"]["mkl_mode"] == "default"
    monkeypatch.setenv("MKL_CBWR", "COMPATIBLE")
    monkeypatch.setenv("ATEN_CPU_CAPABILITY", "default")
    write = lambda job: {"rollouts": 50, "file": (job.folder / "data.bin").write_bytes(b"other bytes")}
    monkeypatch.setitem(fake_stages.ANSWERS, "generate", write)
    call("generate", "tiny.toml", "--store", "other")
    call("generate", "tiny.toml", "--set", "seed=2")
    lines = call("verify").stdout.splitlines()
    assert "made with different mkl_mode:" in lines
    assert [line.split(":")[0].strip() for line in lines[lines.index("made with different mkl_mode:") + 1 :][:2]] == [
        "default", "COMPATIBLE"]  # fmt: skip
    key = document(call("generate", "tiny.toml", "--json", "--store", "other"))["stages"][0]["key"]
    found = call("diff", f"artifacts/generate/{key}", f"other/generate/{key}").stdout.splitlines()
    assert "file data.bin differs" in found and 'made with mkl_mode: "default" -> "COMPATIBLE"' in found
    assert not any(line.startswith("made with made") for line in found)


def test_ls_says_when_a_result_was_made_not_when_its_file_was_copied(call: Call):
    call("generate", "tiny.toml")
    folder = Store(Path("artifacts")).find("generate").folder
    made_at(folder, datetime(2020, 1, 2, 12, tzinfo=UTC))
    assert "2020-01-02" in call("ls").stdout
    assert document(call("ls", "--json"))["artifacts"][0]["made"] == "2020-01-02T12:00:00+00:00"
