"""Executors: the same protocol and results in this process, in processes, on a cluster; lost work is done again."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future, wait
from pathlib import Path

import pytest
from conftest import process_environment

from npred.base.errors import ConfigError, MissingError, NpredError
from npred.lab.scheduler import executors
from npred.lab.scheduler.executors import Cluster, Here, Processes


def square(x: int) -> int:
    return x * x


def refuse(x: int) -> int:
    raise ConfigError(f"no {x}")


def die_once(mark: str) -> int:
    """Kills its own process, unless the mark says that it has done so before."""
    if not os.path.exists(mark):
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def die(x: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_one_job_is_this_process():
    with executors.opened("local", 1) as executor:
        assert isinstance(executor, Here) and executor.submit(os.getpid).result() == os.getpid()


def test_completed_holds_no_more_than_two_results_a_worker():
    class Counting(Here):
        handed_in = 0

        def submit(self, fn, /, *args, **kwargs) -> Future:
            self.handed_in += 1
            return super().submit(fn, *args, **kwargs)

    executor, ahead, found = Counting(), [], {}
    for item, result in executors.completed(executor, square, range(20)):
        found[item] = result
        ahead.append(executor.handed_in - len(found))
    assert found == {x: x * x for x in range(20)} and max(ahead) == 1


def test_workers_that_leave_are_no_reason_to_stop():
    class Shrinking(Here):
        left = 5

        @property
        def count(self) -> int:  # type: ignore[override]
            self.left = max(self.left - 1, 1)
            return self.left

    assert dict(executors.completed(Shrinking(), square, range(20))) == {x: x * x for x in range(20)}


def test_what_a_task_raises_ends_the_rest():
    done = []
    with pytest.raises(ConfigError, match=r"no [01]"):
        for item, _ in executors.completed(Here(), refuse, range(5)):
            done.append(item)
    assert done == []


def test_processes_do_the_work_and_bring_the_errors_back():
    with executors.opened("local", 2) as executor:
        if isinstance(executor, Here):
            pytest.skip("one processor")
        assert dict(executors.completed(executor, square, range(6))) == {x: x * x for x in range(6)}
        assert executor.submit(os.getpid).result() != os.getpid()
        with pytest.raises(ConfigError, match="no 3"):
            executor.submit(refuse, 3).result()


def test_work_lost_with_a_killed_process_is_done_again(tmp_path):
    executor = Processes(2)
    marks = [str(tmp_path / name) for name in "ab"]
    lost = [executor.submit(die_once, mark) for mark in marks[:1]]
    wait(lost)
    assert lost[0].result() != os.getpid()
    assert executor.submit(square, 7).result() == 49
    executor.shutdown()


def ended(pid: int) -> bool:
    """Whether a process ends within ten seconds, or has."""
    try:
        descriptor = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([descriptor], [], [], 10)[0])
    finally:
        os.close(descriptor)


def test_an_interrupted_run_ends_its_processes_at_once(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    pid = 0
    with pytest.raises(KeyboardInterrupt), executors.opened("local", 2) as executor:
        pid = executor.submit(os.getpid).result()
        executor.submit(signal.pause)
        executor.submit(signal.pause)
        raise KeyboardInterrupt
    assert pid and ended(pid)


def test_processes_do_not_outlive_a_parent_that_was_killed():
    program = (
        "import os, signal\nfrom npred.lab.scheduler.executors import Processes\n"
        "print(Processes(1).submit(os.getpid).result(), flush=True)\nos.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], env=process_environment(), stdout=subprocess.PIPE, text=True, timeout=60
    )
    assert done.returncode == -signal.SIGKILL and ended(int(done.stdout))


def test_a_task_that_always_kills_its_process_is_told_in_one_line():
    executor = Processes(1)
    with pytest.raises(NpredError, match=r"^expected processes that survive, got one killed twice; use fewer --jobs$"):
        executor.submit(die, 0).result()
    assert executor.submit(square, 3).result() == 9
    executor.shutdown()


class KilledWorker(Exception):
    """Known by its name, as Dask's."""


class Lost:
    """A client, its executor, and a cluster that loses all that it is given."""

    def __init__(self, end: Callable[[Future], object]) -> None:
        self.end, self.closed = end, False

    def get_executor(self, pure: bool) -> "Lost":
        return self

    def submit(self, fn, /, *args, **kwargs) -> Future:
        future = Future()
        self.end(future)
        return future

    def nthreads(self) -> dict[str, int]:
        return {}


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (lambda f: (f.cancel(), f.set_running_or_notify_cancel()), "expected a scheduler that keeps running, lost it"),
        (
            lambda f: f.set_exception(KilledWorker("4 workers died")),
            "expected workers that survive, got: 4 workers died",
        ),
    ],
    ids=["scheduler", "workers"],
)
def test_a_cluster_that_is_lost_is_told_in_one_line(end, words):
    executor = Cluster(Lost(end))
    with pytest.raises(NpredError, match=f"^--executor: {words}"):
        dict(executors.completed(executor, square, range(3)))


def test_a_task_of_a_cluster_can_be_cancelled():
    given: list[Future] = []
    task = Cluster(Lost(given.append)).submit(square, 3)
    assert task.cancel() and given[0].cancelled()


@pytest.mark.parametrize("spec", ["dask", "dask:", "ray:there", ""])
def test_another_spec_is_refused(spec):
    with pytest.raises(ConfigError, match="expected local or dask:ADDRESS"), executors.opened(spec, 1):
        pass


def test_a_missing_extra_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingError, match=r"pip install 'npred\[dask\]'"), executors.opened("dask:tcp://a:1", 1):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "there"])
def test_a_scheduler_that_does_not_answer_is_told(address, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "ANSWER", 0.5)
    with pytest.raises(NpredError, match="expected a Dask scheduler at"), executors.opened(f"dask:{address}", 1):
        pass
