"""The memory that a controller on a real clock has of its calls: npred/kernels/c/controller.h reads and writes it.

Positions count control steps of a regular clock, in the rows of the history of commands.
"""

from typing import Any

import numpy as np

STAMPS = (
    "at",  # position of the last call
    "now_at",  # position of the state `now` that the model goes on from
    "base_at",  # position of the state `base` of the last used sample
    "sample_at",  # position of the last used sample
    "renewed_at",  # position of the first sample, of one that was doubtful, or where the filter last restarted
    "tick",  # position of the last control step that the observer of the delay did
    "lag",  # control steps that it runs behind, the largest age of a sample
    "calls",  # 0 before the first call
    "late",  # samples that came too late, or after a newer one
    "refused",  # samples that were refused, because they were too far from the model
    "renewed",  # times that the filter restarted
    "stray",  # 1 if a state far from the box was accepted
    "handed",  # 1 if the watchdog gives U
    "moving",  # 1 while U goes from the law to the watchdog's or back
)


def declared() -> str:
    """The C of the names."""
    return f"enum {{ {', '.join(name.upper() for name in (*STAMPS, 'stamps'))} }};"


class Clock:
    """Views of that memory, a flat array: the stamps by name, then `sent`, `before`, `D` (m), `now`, `base` (n),
    `refused` (outputs).

    sent is the last command, before the mean of those before it in the control step of its call, D the delays by which
    the last call read the commands, and refused the first of the samples in a row in which an output was refused.
    """

    def __init__(self, n: int, m: int, outputs: int) -> None:
        ends = np.cumsum([len(STAMPS), m, m, m, n, n, outputs]).tolist()
        self.memory = np.full(ends[-1], np.nan)
        self.sent, self.before, self.D, self.now, self.base, self.refused = (
            self.memory[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)
        )

    def __getitem__(self, stamp: str) -> float:
        return float(self.memory[STAMPS.index(stamp)])

    def start(self, k: int, U: np.ndarray, D: np.ndarray, X: np.ndarray | None, calls: int = 0) -> None:
        """Set it before the call of control step k, where the model expects X (n), after the command U (m)."""
        self.memory[:] = np.nan
        zeros = ("lag", "late", "refused", "renewed", "stray", "handed", "moving")
        self.memory[[STAMPS.index(name) for name in zeros]] = 0.0
        self.memory[STAMPS.index("at")], self.memory[STAMPS.index("calls")] = k - 1, calls
        self.memory[STAMPS.index("now_at")] = k
        self.sent[:], self.before[:], self.D[:] = U, U, D
        self.now[:] = np.nan if X is None else X

    def forget(self) -> None:
        """Expect nothing of the next sample, and take the next call for the first."""
        for name in ("base_at", "sample_at", "renewed_at", "tick"):
            self.memory[STAMPS.index(name)] = np.nan
        self.memory[STAMPS.index("calls")] = 0.0
        self.now[:] = self.base[:] = self.refused[:] = np.nan

    def state(self) -> list[float | None]:
        """The memory, ready for JSON."""
        return [None if np.isnan(value) else value for value in self.memory.tolist()]

    def restore(self, numbers: Any) -> None:
        """Set it to a state. Raises ValueError or TypeError for any other value."""
        values = np.array([np.nan if value is None else value for value in numbers], dtype=float)
        if (
            values.shape != self.memory.shape
            or not np.isfinite(values[[STAMPS.index("at"), STAMPS.index("lag")]]).all()
        ):
            raise ValueError("a clock of other sizes")
        self.memory[:] = values
