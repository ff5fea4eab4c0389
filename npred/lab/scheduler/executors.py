"""Executors of parallel work: processes of this machine, or a cluster that Dask runs. They never change a result.

    with executors.opened("dask:tcp://head:8786", jobs=2) as executor:  # or "local"
        for item, result in executors.completed(executor, function, items):
            ...

`function` is one of a module, and it, the items and the results are pickled: they are plain data, no open files.
"""

import logging
import os
import signal
import threading
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from concurrent.futures.process import ProcessPoolExecutor
from concurrent.futures.thread import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, TypeVar

from npred.base.errors import ConfigError, NpredError, first_line, required
from npred.lab.report.terminal import interruption

if TYPE_CHECKING:
    from distributed import Client

LOCAL = "local"
ANSWER = 10  # seconds that a scheduler may take to answer
BEAT = 0.2  # s between two looks for a signal
Item = TypeVar("Item")
Result = TypeVar("Result")


class Workers(Executor):
    """An executor that knows how many tasks it works on side by side, and whether on this machine."""

    count: int
    remote = False


def opened(spec: str, jobs: int) -> AbstractContextManager[Workers]:
    """The executor meant by `local` (jobs processes; one job: this process) or `dask:ADDRESS`; closed at the end.

    Processes start when work comes; those of an interrupted run end at once. Raises ConfigError for another spec,
    MissingError without the extra, NpredError where no scheduler answers.
    """
    if spec == LOCAL:
        count = min(jobs, os.cpu_count() or 1)
        return closed(Processes(count) if count > 1 else Here())
    engine, _, address = spec.partition(":")
    if engine != "dask" or not address:
        raise ConfigError(f"--executor: expected local or dask:ADDRESS, got {spec!r}; as dask:tcp://localhost:8786")
    client = required("--executor", "distributed", "distributed", "dask").Client
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what fails is said once, in a line
    try:
        return closed(Cluster(client(address, timeout=ANSWER, set_as_default=False)))
    except (OSError, ValueError) as error:
        expected = f"--executor: expected a Dask scheduler at {address}"
        raise NpredError(f"{expected}, got: {first_line(error)}; start one there with dask scheduler") from None


@contextmanager
def closed(executor: Workers) -> Iterator[Workers]:
    """The executor, closed after the block: once its work is done, or without waiting for it where the block fails."""
    try:
        yield executor
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        raise
    executor.shutdown()


def completed(
    executor: Workers, function: Callable[[Item], Result], items: Iterable[Item]
) -> Iterator[tuple[Item, Result]]:
    """(item, function(item)) in the order in which they end.

    Two items per worker are under way, no more: the results of the others need not fit in memory. Raises what
    `function` raises, after it has cancelled the rest.
    """
    left, under_way = iter(items), dict[Future[Result], Item]()
    try:
        while True:
            room = max(2 * executor.count - len(under_way), 0)  # workers may have left since
            for item in islice(left, room):
                under_way[executor.submit(function, item)] = item
            if not under_way:
                return
            for done in ended(under_way):
                yield under_way.pop(done), done.result()
    finally:
        for future in under_way:
            future.cancel()


def ended(under_way: Collection[Future[Result]]) -> list[Future[Result]]:
    """Those of the futures that have ended, one at least. Raises KeyboardInterrupt once a signal has arrived."""
    while not any(future.done() for future in under_way):
        interruption.check()
        wait(under_way, BEAT, FIRST_COMPLETED)
    return [future for future in under_way if future.done()]


class Here(Workers):
    """No other process: the work is done while it is handed in."""

    count = 1

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """The future of a call that is over."""
        future: Future[Result] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Threads(ThreadPoolExecutor, Workers):
    """Threads of this process."""

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self.count = count


class Processes(Workers):
    """Processes of this machine. The work of one that died, of memory say, is done again by fresh ones, once."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._changing, self._closed = threading.Lock(), False
        self._pool, self._parent_pipe = self._fresh()

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """The future of a call in one of the processes."""
        outcome: Future[Result] = Future()
        self._start(partial(fn, *args, **kwargs), outcome, retries=1)
        return outcome

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after their work, or, without `wait`, now."""
        self._closed = True
        self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)
        self._parent_pipe.close()

    def _start(self, call: Callable[[], Result], outcome: Future[Result], retries: int) -> None:
        pool = self._pool
        with signals_blocked():
            try:
                inner = pool.submit(call)
            except BrokenExecutor:
                pool = self._replace(pool)
                inner = pool.submit(call)
        inner.add_done_callback(lambda done: self._finish(done, call, outcome, pool, retries))

    def _finish(
        self, done: Future[Result], call: Callable[[], Result], outcome: Future[Result], pool: Executor, retries: int
    ) -> None:
        error = CancelledError() if done.cancelled() else done.exception()
        if not isinstance(error, BrokenExecutor):
            _settle(outcome, error, done)
        elif retries and not self._closed and not outcome.cancelled():
            self._replace(pool)
            try:
                self._start(call, outcome, retries - 1)
            except RuntimeError as lost:  # the fresh pool is closed or broken already: somebody may wait
                _settle(outcome, lost, done)
        else:
            what = "expected processes that survive, got one killed twice; use fewer --jobs"
            _settle(outcome, NpredError(what), done)

    def _replace(self, broken: Executor) -> ProcessPoolExecutor:
        """A fresh pool for a broken one: once, however many of its tasks ask."""
        with self._changing:  # no lock of a pool is taken in here: its thread may hold that one and wait for this
            if self._pool is broken:
                self._parent_pipe.close()
                self._pool, self._parent_pipe = self._fresh()
            return self._pool

    def _fresh(self) -> tuple[ProcessPoolExecutor, Connection]:
        """Processes start afresh: a fork would copy the threads' locks of whatever the caller has loaded."""
        context = get_context("spawn")
        end, parent_pipe = context.Pipe(duplex=False)
        with signals_blocked():  # multiprocessing starts a process that watches its semaphores
            return ProcessPoolExecutor(self.count, context, _end_with_parent, (end,)), parent_pipe


@contextmanager
def signals_blocked() -> Iterator[None]:
    """Processes that start in the block do not get a terminal's signals: they end with this one, silently."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows, where the processes themselves ignore signals
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _settle(outcome: Future[Result], error: BaseException | None, done: Future[Result]) -> None:
    """Give a future this error, or without one the other future's answer."""
    if outcome.set_running_or_notify_cancel():
        if error:
            outcome.set_exception(error)
        else:
            outcome.set_result(done.result())


def _end_with_parent(end: Connection) -> None:
    """End a worker whose parent was killed or ends early, which closes the pipe: it would wait for tasks for ever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        try:
            end.recv()
        except (EOFError, OSError):
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class Cluster(Workers):
    """The workers of a Dask scheduler. Dask does the work of a worker that died again, elsewhere."""

    remote = True

    def __init__(self, client: "Client") -> None:
        self._client, self._inner = client, client.get_executor(pure=False)

    @property
    def count(self) -> int:  # type: ignore[override]
        """The threads of all workers now: they come and go."""
        return max(sum(self._client.nthreads().values()), 1)  # type: ignore[union-attr]

    def submit(self, fn: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """The future of a call on one of the workers."""
        outcome: Future[Result] = Future()
        inner = self._inner.submit(fn, *args, **kwargs)

        def finish(done: Future[Result]) -> None:  # the cluster's failures in one line each
            error = CancelledError() if done.cancelled() else done.exception()
            if isinstance(error, CancelledError):
                what = "expected a scheduler that keeps running, lost it; start it and run the same command again"
                error = NpredError(f"--executor: {what}")
            elif type(error).__name__ == "KilledWorker":
                error = NpredError(f"--executor: expected workers that survive, got: {error}; give them more memory")
            _settle(outcome, error, done)

        outcome.add_done_callback(lambda done: done.cancelled() and inner.cancel())
        inner.add_done_callback(finish)
        return outcome

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which stays up: after the work, or, without `wait`, now."""
        self._inner.shutdown(wait=wait and not cancel_futures)
        self._client.close()
