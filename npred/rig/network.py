"""A network between two programs: what becomes of a packet is a function of the seed, its way and its number."""

import math
from dataclasses import dataclass

from npred import array_checks, randomness
from npred.errors import ConfigError

STOP = 0.2  # s that the network stands still


@dataclass(frozen=True)
class Channel:
    """Packets take delay + jitter r seconds, r uniform on [-1, 1], each by itself, so that they overtake each other.

    The share `loss` never arrives, the share `reorder` takes twice its time; `stops` times a minute all that is sent
    within 0.2 s is lost. Raises ConfigError for values out of range.
    """

    delay: float = 0.12
    jitter: float = 0.02
    loss: float = 0.0
    reorder: float = 0.0
    stops: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        limits = {"delay": math.inf, "jitter": self.delay, "loss": 1.0, "reorder": 1.0, "stops": 30 / STOP}
        for name, high in limits.items():
            value = array_checks.number(f"network: {name}", getattr(self, name))
            if not 0 <= value <= high or value == math.inf:
                raise ConfigError(f"network: expected {name} from 0 to {high:g}, got {value:g}; give another")

    @property
    def longest(self) -> float:
        """The longest time from sending to arrival, in seconds."""
        return (self.delay + self.jitter) * (2 if self.reorder else 1)

    def arrival(self, way: str, number: int, sent_at: float) -> float:
        """When packet `number` of a way arrives that is sent at that time, in seconds; infinity where it is lost."""
        lost, spread, slow = randomness.generator(self.seed, way, number).random(3)
        if lost < self.loss or self.stopped(sent_at):
            return math.inf
        return sent_at + (self.delay + self.jitter * (2 * spread - 1)) * (2 if slow < self.reorder else 1)

    def stopped(self, t: float) -> bool:
        """Whether the network stands still at a time: once in each of the `stops` parts of a minute."""
        if not self.stops:
            return False
        span = 60 / self.stops
        part = int(t // span)
        begin = part * span + (span - STOP) * randomness.generator(self.seed, "stop", part).random()
        return begin <= t < begin + STOP
