"""Which of the actions under way acts: the newest that has arrived."""

import math
from typing import Any, NamedTuple

import numpy as np

NEARLY = 1e-9  # of a substep: the rounding of a delay in seconds


class HeldAction(NamedTuple):
    """An action, and for how many control steps it acts; a fraction is whole substeps of the simulator."""

    action: np.ndarray
    steps: float


class Path:
    """Numbered actions and the substeps at which they arrive; until then `first` acts, or, if None, time stands still.

    Each travels by itself, so that actions may overtake each other: the newest that has arrived acts, and one that
    arrives after a newer one never does. A control step has `substeps`. The oldest kept is number `dropped`.
    """

    def __init__(self, first: Any, substeps: int = 1) -> None:
        self.first, self.substeps = first, substeps
        self.actions, self.arrivals, self.dropped = list[np.ndarray](), list[int](), 0

    def __len__(self) -> int:
        return self.dropped + len(self.actions)

    def ticks(self, steps: float) -> int:
        """Substeps of a time in control steps: an action that arrives within a substep acts from the next."""
        return math.ceil(steps * self.substeps - NEARLY)

    def send(self, action: Any, arrival: int) -> None:
        self.actions.append(np.array(action))
        self.arrivals.append(arrival)

    def acting(self, tick: int) -> int:
        """The place in `actions` of the one that acts at a substep; -1 for `first`."""
        return max((k for k, arrival in enumerate(self.arrivals) if arrival <= tick), default=-1)

    def action(self, tick: int) -> Any:
        return self.actions[k] if (k := self.acting(tick)) >= 0 else self.first

    def pieces(self, begin: int, end: int) -> list[HeldAction]:
        """What acts from one substep to another."""
        changes = [begin, *sorted({a for a in self.arrivals if begin < a < end}), end]
        spans = zip(changes, changes[1:], strict=False)
        acting = [(self.action(a), (b - a) / self.substeps) for a, b in spans if b > a]
        return [HeldAction(*each) for each in acting if each[0] is not None]

    def forget(self, tick: int) -> None:
        if (k := self.acting(tick)) > 0:
            del self.actions[:k], self.arrivals[:k]
            self.dropped += k
