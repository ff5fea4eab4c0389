"""A console that shows nothing and keeps what it was told."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager


class Silent:
    """Collects the notes of its bars; `stop_after` advances raises KeyboardInterrupt, as Ctrl-C would."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.notes: list[str] = []
        self.phases: list[str] = []
        self.measurements: list[tuple[str, dict[str, float]]] = []
        self.done, self.calls, self.stop_after = 0, 0, stop_after

    @contextmanager
    def bar(self, title: str, total: int, unit: str, done: int = 0) -> Iterator["Silent"]:
        self.done += done
        yield self

    def doing(self, title: str, what: str) -> None:
        self.phases.append(f"{title}: {what}")

    def advance(self, n: int = 1, note: str = "") -> None:
        self.done += n
        self.notes.append(note)
        self.calls += n > 0
        if self.stop_after is not None and self.calls > self.stop_after:
            raise KeyboardInterrupt

    def finish(self, title: str, action: str, seconds: float) -> None:
        self.notes.append(f"{title}: {action}")

    def measured(self, title: str, values: Mapping[str, float]) -> None:
        self.measurements.append((title, dict(values)))

    def stop(self) -> None:
        self.stop_after = -1

    def note(self, text: str) -> None:
        self.notes.append(text)

    def warn(self, text: str) -> None:
        self.notes.append(text)
