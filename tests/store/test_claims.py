"""Claims: what a run has taken stays in use until it ends, however it ends."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import document, process_environment

from npred.lab.store import claims


def lock_files(root):
    return sorted(path.name for path in (root / ".locks").glob("run-*"))


def test_a_claim_holds_until_its_block_ends(tmp_path):
    with claims.claimed(tmp_path) as claim:
        claim("a" * 64)
        with claims.claimed(tmp_path) as other:
            other("b" * 64)
            assert claims.in_use(tmp_path) == {"a" * 64, "b" * 64}
        assert claims.in_use(tmp_path) == {"a" * 64}
    assert claims.in_use(tmp_path) == set() and lock_files(tmp_path) == []


def test_a_process_that_was_killed_claims_nothing(tmp_path):
    program = (
        "import sys, time\nfrom pathlib import Path\nfrom npred.lab.store import claims\n"
        "with claims.claimed(Path(sys.argv[1])) as claim:\n"
        "    claim('c' * 64)\n    print('claimed', flush=True)\n    sys.stdin.read()\n"
    )
    command, pipe = [sys.executable, "-c", program, str(tmp_path)], subprocess.PIPE
    running = subprocess.Popen(command, env=process_environment(), stdin=pipe, stdout=pipe, text=True)
    assert running.stdout is not None and running.stdout.readline() == "claimed\n"
    assert claims.in_use(tmp_path) == {"c" * 64}
    running.send_signal(signal.SIGKILL)
    running.wait()
    assert claims.in_use(tmp_path) == set() and lock_files(tmp_path) == []


@pytest.mark.skipif(getattr(os, "geteuid", int)() == 0, reason="root and Windows write everywhere")
def test_a_store_that_cannot_be_written_takes_no_claims(tmp_path):
    tmp_path.chmod(0o500)
    with claims.claimed(tmp_path) as claim:
        claim("a" * 64)
    tmp_path.chmod(0o700)
    assert list(tmp_path.iterdir()) == []


def test_gc_leaves_what_a_run_has_taken(call):
    """The data of another seed, which no pipeline needs, while a run trains from them, and when it has ended."""
    made = document(call("generate", "tiny.toml", "--set", "seed=7", "--json"))["stages"][0]
    with claims.claimed(Path("artifacts")) as claim:
        claim(made["key"])
        assert document(call("gc", "tiny.toml", "--yes", "--json"))["deleted"] == []
    assert len(document(call("gc", "tiny.toml", "--yes", "--json"))["deleted"]) == 1


def test_a_claim_that_is_taken_for_one_left_behind_is_made_again(tmp_path, monkeypatch):
    """Another process may lock and remove the file between its opening and its lock, or before that lock is there."""
    held, moments = claims.held, iter(["held elsewhere", "removed"])

    @contextmanager
    def disturbed(path, waiting=None):
        moment = next(moments, "")
        if moment == "held elsewhere":
            raise claims.HeldError
        with held(path, waiting):
            if moment == "removed":
                path.unlink()
            yield

    monkeypatch.setattr(claims, "held", disturbed)
    with claims.claimed(tmp_path) as claim:
        claim("a" * 64)
        assert claims.in_use(tmp_path) == {"a" * 64}
    assert lock_files(tmp_path) == []


def test_a_name_that_no_claim_has_is_left_alone(tmp_path):
    (tmp_path / ".locks").mkdir()
    (tmp_path / ".locks" / "run-mine.lock").write_text("x")
    assert claims.in_use(tmp_path) == set() and lock_files(tmp_path) == ["run-mine.lock"]


def test_no_claim_is_invisible_to_processes_that_look_while_it_is_made(tmp_path):
    """Four processes, each making claims and looking at all of them; each has to see its own."""
    program = (
        "import sys\nfrom pathlib import Path\nfrom npred.lab.store import claims\n"
        "root, lost = Path(sys.argv[1]), 0\n"
        "for number in range(400):\n"
        "    key = sys.argv[2] * 32 + f'{number:032x}'\n"
        "    with claims.claimed(root) as claim:\n"
        "        claim(key)\n        lost += key not in claims.in_use(root)\n"
        "print(lost)\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path)]
    processes = [
        subprocess.Popen([*command, digit], env=process_environment(), stdout=subprocess.PIPE, text=True)
        for digit in "abcd"
    ]
    assert [process.communicate()[0] for process in processes] == ["0\n"] * 4
    assert lock_files(tmp_path) == []
