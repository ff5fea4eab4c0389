"""Signals: during imports, twice, and to a process that ignores them."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import HERE, process_environment

from npred.lab.report.terminal import interruption

if not hasattr(signal, "SIGHUP"):
    pytest.skip("this system sends no signals to a process", allow_module_level=True)
SIGNALS = [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
# A finder is asked for each module before it is imported: there the process signals itself.
DURING = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), {number})
sys.meta_path.insert(0, Finder())
sys.argv = ["npred", *{arguments!r}]
from npred.__main__ import main
main()
"""
# Two signals: the second comes while the work that the first asked to end still goes on.
TWICE = """
import os, signal, time
from npred.lab.report.terminal import interruption
interruption.GRACE = 60
interruption.listen()
with interruption.graceful():
    os.kill(os.getpid(), {first})
    while not interruption.interrupted():
        pass
    {said}
    os.kill(os.getpid(), {second})
    time.sleep(60)
"""
# The signal comes when concurrent.futures holds the locks of the futures that it waits for, and their work ends.
LOCKED = """
import os, signal
from concurrent.futures import _base
from threading import Event
from npred.cli.app import guarded
from npred.lab.scheduler import executors
from npred.lab.report.terminal import interruption
from npred.lab.report.terminal.console import Console
enter, gate = _base._AcquireFutures.__enter__, Event()
def entered(self):
    enter(self)
    gate.set()
    os.kill(os.getpid(), {number})
_base._AcquireFutures.__enter__ = entered
interruption.listen()
def work():
    with interruption.graceful(), executors.closed(executors.Threads(2)) as threads:
        for _ in executors.completed(threads, gate.wait, [60] * 4):
            pass
raise SystemExit(guarded(work, Console()))
"""
# Work that does not look for a signal: Python calls no handler in it, and no exception would end it.
DEAF = """
import hashlib, os, signal
from contextlib import nullcontext
from threading import Timer
from npred.lab.report.terminal import interruption
interruption.GRACE = 0.1
interruption.listen()
with {where}:
    Timer(0.1, os.kill, (os.getpid(), {number})).start()
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
"""
# What multiprocessing puts away at the end waits for somebody who is gone.
STUCK = """
import os, signal
from multiprocessing import util
from threading import Event
from npred.lab.report.terminal import interruption
interruption.GRACE = 0.1
util.Finalize(None, print, ("first",), kwargs=dict(flush=True), exitpriority=2)
util.Finalize(None, Event().wait, exitpriority=1)
util.Finalize(None, print, ("last",), kwargs=dict(flush=True), exitpriority=0)
interruption.listen()
os.kill(os.getpid(), {number})
Event().wait()
"""
# A semaphore that nothing puts away, for its last user is stuck.
LEFT = """
import multiprocessing, os, signal
from multiprocessing import util
from threading import Event
from npred.lab.report.terminal import interruption
interruption.GRACE = 0.1
interruption.listen()
lock = multiprocessing.get_context("spawn").Lock()
util._finalizer_registry.clear()
os.kill(os.getpid(), {number})
Event().wait()
"""


def run(program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = ["env", "--default-signal=INT,TERM,HUP", sys.executable, "-c", program]
    return subprocess.run(command, cwd=folder, env=process_environment(), capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize(("number", "code"), SIGNALS)
@pytest.mark.parametrize("module", ["npred.cli", "npred.lab.store", "numpy"])
def test_a_signal_during_imports_says_so(tmp_path: Path, number: int, code: int, module: str):
    done = run(DURING.format(module=module, number=int(number), arguments=["plants", "check", "scalar"]), tmp_path)
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr == f"error: {interruption.LINE}\n"


def test_a_signal_while_typer_writes_the_help_says_so(tmp_path: Path):
    """typer makes code 130 and no word of a KeyboardInterrupt."""
    program = DURING.format(module="typer._click._textwrap", number=int(signal.SIGTERM), arguments=["--help"])
    done = run(program, tmp_path)
    assert (done.returncode, done.stderr) == (143, f"error: {interruption.LINE}\n")


@pytest.mark.parametrize(("number", "code"), SIGNALS)
def test_a_signal_while_futures_are_locked_ends_the_program(tmp_path: Path, number: int, code: int):
    done = run(LOCKED.format(number=int(number)), tmp_path)
    assert (done.returncode, done.stderr) == (code, f"error: {interruption.LINE}\n")


@pytest.mark.parametrize("where", ["nullcontext()", "interruption.graceful()"])
def test_work_that_does_not_look_for_a_signal_is_ended(tmp_path: Path, where: str):
    done = run(DEAF.format(where=where, number=int(signal.SIGHUP)), tmp_path)
    assert (done.returncode, done.stderr) == (129, f"error: {interruption.LINE}\n")


@pytest.mark.parametrize(("number", "code"), SIGNALS)
def test_finalizers_that_wait_for_ever_are_left(tmp_path: Path, number: int, code: int):
    done = run(STUCK.format(number=int(number)), tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (code, "first\n", f"error: {interruption.LINE}\n")


@pytest.mark.parametrize(("number", "code"), SIGNALS)
def test_what_is_left_for_the_tracker_is_put_away_without_a_word(tmp_path: Path, number: int, code: int):
    done = run(LEFT.format(number=int(number)), tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", f"error: {interruption.LINE}\n")


@pytest.mark.parametrize(("first", "code"), SIGNALS)
@pytest.mark.parametrize("said", ["pass", "interruption.say(lambda line: os.write(2, f'error: {line}\\n'.encode()))"])
def test_a_second_signal_ends_at_once_with_the_code_of_the_first(tmp_path: Path, first: int, code: int, said: str):
    done = run(TWICE.format(first=int(first), second=int(signal.SIGTERM), said=said), tmp_path)
    assert (done.returncode, done.stderr) == (code, f"error: {interruption.LINE}\n")


def test_what_is_ignored_stays_ignored(tmp_path: Path):
    program = (
        "import os, signal\nfrom npred.lab.report.terminal import interruption\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "interruption.listen()\nos.kill(os.getpid(), signal.SIGHUP)\nprint('alive')"
    )
    assert run(program, tmp_path).stdout == "alive\n"


@pytest.mark.parametrize("error", ["ImportError('half a module')", "RuntimeError('the callback failed')"])
def test_what_a_library_makes_of_a_signal_is_an_interruption(tmp_path: Path, error: str):
    program = (
        f"import os, signal, sys\nsys.path.insert(0, {str(HERE)!r})\nimport fake_stages\n"
        "def interrupted(job):\n    try:\n        os.kill(os.getpid(), signal.SIGTERM)\n"
        f"    except BaseException:\n        raise {error}\n"
        "fake_stages.install()\nfake_stages.ANSWERS['generate'] = interrupted\n"
        "sys.argv = ['npred', 'generate', 'tiny.toml', '-q']\nfrom npred.__main__ import main\nmain()\n"
    )
    (tmp_path / "tiny.toml").write_text('plant = "scalar"\n')
    done = run(program, tmp_path)
    assert (done.returncode, done.stderr) == (143, f"error: {interruption.LINE}\n")


def test_where_no_thread_starts_any_more_nothing_is_waited_for(monkeypatch: pytest.MonkeyPatch):
    """Python 3.12 refuses a thread while the interpreter is taken down."""

    def refuse(*_: object) -> None:
        raise RuntimeError("can't create new thread at interpreter shutdown")

    monkeypatch.setattr(interruption._thread, "start_new_thread", refuse)
    called: list[None] = []
    interruption._bounded(lambda: called.append(None))
    assert called == []
