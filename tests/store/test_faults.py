"""A store that runs out of disk, is wanted by many at once, or loses its runs: whole, and nothing is done twice."""

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fake_stages
import pytest
from conftest import HERE, Call, document, process_environment

from npred.lab.store import Store

Disk = Callable[[str], Path]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """A small disk of its own; called again, of another size."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def sized(size: str) -> Path:
        again = "remount," if folder.is_mount() else ""
        command = ["mount", "-t", "tmpfs", "-o", f"{again}size={size}", "tmpfs", str(folder)]
        if subprocess.run(command, capture_output=True).returncode:
            pytest.skip("mounting takes more rights")
        return folder

    yield sized
    if folder.is_mount():
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("size", ["4k", "64k", "120k", "200k"])
def test_a_full_disk_is_one_line_and_the_next_run_goes_on(call: Call, disk: Disk, monkeypatch: Any, size: str):
    """The first results fit, the next do not; on the smallest not even the lock."""
    real = dict(fake_stages.ANSWERS)
    for name, answer in real.items():
        monkeypatch.setitem(fake_stages.ANSWERS, name, lambda job, answer=answer: _bulky(job) and answer(job))
    folder = disk(size)
    failed = call("run", "tiny.toml", "--jobs", "1", "--store", folder)
    assert failed.exit_code == 1, failed.output
    assert "expected room to write, got a full disk; free some" in failed.stderr.splitlines()[-1]
    store = Store(folder)
    sound, broken = store.survey()
    assert broken == []
    assert [path.parent.name for path in store.leftovers() if path.parent.name == ".tmp"] == []
    for artifact in sound:
        artifact.verify()
    disk("8m")
    rows = document(call("run", "tiny.toml", "--jobs", "1", "--store", folder, "--json"))["stages"]
    assert {row["key"] for row in rows if row["action"] == "hit"} == {artifact.manifest.key for artifact in sound}
    assert call("verify", "--store", folder).exit_code == 0


def _bulky(job: Any) -> bool:
    (job.folder / "bulk.bin").write_bytes(bytes(40_000))
    return True


def test_libraries_that_hide_a_full_disk_are_understood():
    from npred.base.errors import disk_is_full

    assert disk_is_full(OSError(28, "No space left on device"))
    assert disk_is_full(RuntimeError("write failed: errno = 28, error message = 'No space left on device'"))
    wrapped = ValueError("no")
    wrapped.__cause__ = OSError(122, "Disk quota exceeded")
    assert disk_is_full(wrapped)
    assert not disk_is_full(OSError(13, "Permission denied"))
    assert not disk_is_full(ValueError("28"))


def test_eight_processes_make_each_result_once(pipeline: Path):
    command = [sys.executable, str(HERE / "fake_stages.py"), "run", "tiny.toml", "--json", "--jobs", "1"]
    more = {"cwd": pipeline.parent, "env": process_environment(), "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    processes = [subprocess.Popen(command, text=True, **more) for _ in range(8)]
    answers = [process.communicate(timeout=100) for process in processes]
    assert [process.returncode for process in processes] == [0] * 8, answers
    rows = [row for out, _ in answers for row in json.loads(out)["stages"]]
    made = Counter(row["key"] for row in rows if row["action"] == "run")
    assert len(made) == len(json.loads(answers[0][0])["stages"])
    assert set(made.values()) == {1}
    assert Store(pipeline.parent / "artifacts").leftovers() == []


@pytest.mark.campaign
def test_real_stages_that_are_killed_continue_to_the_same_digests():
    command = [sys.executable, str(HERE / "faults.py"), "4", "0", "1"]
    done = subprocess.run(command, env=process_environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "killed -9: 4 of 4 continued to the same digests" in done.stdout


def test_gc_frees_a_disk_that_is_full(call: Call, disk: Disk):
    """Nothing can be written any more, neither who holds a lock nor a new lock file."""
    folder = disk("1m")
    call("run", "tiny.toml", "--store", folder)
    call("generate", "tiny.toml", "--store", folder, "--set", "seed=7")
    stale = Store(folder).find("generate").folder
    for lock in (folder / ".locks").iterdir():
        lock.unlink()
    _fill(folder)
    done = call("gc", "tiny.toml", "--store", folder, "--yes", "--json")
    assert document(done)["deleted"] == [str(stale)] and not stale.exists()
    (folder / "room").write_bytes(bytes(4096))


def _fill(folder: Path) -> None:
    with pytest.raises(OSError, match="No space left"), (folder / "full").open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass
