"""Tasks in threads, of which each does all by itself but one piece of work: that is done for all of them at once.

So the networks of a sweep train in one CUDA graph, and each keeps its lock, its checkpoint and its result.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, TypeVar

from npred.parallel.executors import BEAT, ended
from npred.terminal import interruption

Item = TypeVar("Item")
Result = TypeVar("Result")
_here = threading.local()


class Meeting:
    """So many tasks. One that needs the work waits for the others: until each of them has come too, or has left."""

    def __init__(self, count: int) -> None:
        self._expected, self._changed = count, threading.Condition()
        self._items: list[Any] = []
        self._results: Future[Sequence[Any]] = Future()

    @contextmanager
    def member(self) -> Iterator[None]:
        """This thread, for a block, is a task of the group."""
        _here.group = self
        try:
            yield
        finally:
            leave()

    def left(self) -> None:
        """One less will come."""
        with self._changed:
            self._expected -= 1
            self._changed.notify_all()

    def result(self, item: Any, work: Callable[[Sequence[Any]], Sequence[Any]]) -> Any:
        """What `work` makes of this item among those of all: the first that came does it. Raises what that raises."""
        with self._changed:
            number = len(self._items)
            self._items.append(item)
            self._changed.notify_all()
            while len(self._items) < self._expected:
                interruption.check()
                self._changed.wait(BEAT)
        if number == 0:
            try:
                self._results.set_result(work(self._items))
            except BaseException as error:
                self._results.set_exception(error)
        ended([self._results])
        return self._results.result()[number]


def leave() -> None:
    """This task is on its own from now on: it waits for somebody outside of its group, or has ended."""
    group, _here.group = getattr(_here, "group", None), None
    if group:
        group.left()


def together(item: Item, work: Callable[[Sequence[Item]], Sequence[Result | Exception]]) -> Result:
    """What `work` makes of this item, among the items of the thread's group if it is in one. Raises its exception."""
    group, _here.group = getattr(_here, "group", None), None
    result: Any = group.result(item, work) if group else work([item])[0]
    if isinstance(result, Exception):
        raise result
    return result
