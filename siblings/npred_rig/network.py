"""A network between two programs: numbered and stamped packets by UDP, each handed over when it is to arrive.

What becomes of a packet is a function of the seed, its way and its number.
"""

import heapq
import math
import select
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from npred.base import array_checks, randomness
from npred.base.errors import ConfigError
from npred.loop.timing import ends, travels

STOP = 0.2  # s that the network stands still
PATIENCE = 2.0  # s without any packet, lost ones too, after which the other side is gone
LONGEST = 65507  # bytes of a packet


@dataclass(frozen=True)
class Channel:
    """Packets take delay + jitter r seconds, r uniform on [-1, 1], each by itself, so that they overtake each other;
    those of a way in `latencies` take those, as npred.Timing has them.

    The share `loss` never arrives, the share `reorder` takes twice its time; `stops` times a minute all that is sent
    within 0.2 s is lost. Raises ConfigError for values out of range.
    """

    delay: float = 0.12
    jitter: float = 0.02
    loss: float = 0.0
    reorder: float = 0.0
    stops: float = 0.0
    seed: int = 0
    latencies: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        limits = {"delay": math.inf, "jitter": self.delay, "loss": 1.0, "reorder": 1.0, "stops": 30 / STOP}
        for name, high in limits.items():
            value = array_checks.number(f"network: {name}", getattr(self, name))
            if not 0 <= value <= high or value == math.inf:
                raise ConfigError(f"network: expected {name} from 0 to {high:g}, got {value:g}; give another")

    @property
    def longest(self) -> float:
        """The longest time from sending to arrival, in seconds."""
        times = [ends(latency)[1] for latency in self.latencies.values()]
        usual = [self.delay + self.jitter] if len(times) < 2 else []
        return max(times + usual) * (2 if self.reorder else 1)

    def arrival(self, way: str, number: int, sent_at: float) -> float:
        """When packet `number` of a way arrives that is sent at that time, in seconds; infinity where it is lost."""
        lost, spread, slow = randomness.generator(self.seed, way, number).random(3)
        if lost < self.loss or self.stopped(sent_at):
            return math.inf
        takes = self.delay + self.jitter * (2 * spread - 1)
        if way in self.latencies:
            takes = float(travels(self.latencies[way], np.array([number]), np.array([spread]))[0])
        return sent_at + takes * (2 if slow < self.reorder else 1)

    def stopped(self, t: float) -> bool:
        """Whether the network stands still at a time: once in each of the `stops` parts of a minute."""
        if not self.stops:
            return False
        span = 60 / self.stops
        part = int(t // span)
        begin = part * span + (span - STOP) * randomness.generator(self.seed, "stop", part).random()
        return begin <= t < begin + STOP


class Packet(NamedTuple):
    """A packet that arrived: its times in seconds since the start, and its values."""

    arrival: float
    number: int
    sent_at: float
    values: np.ndarray


class UdpLink:
    """One end of two: sends packets, and receives those of the way `back`; `start` is 0 on the common clock.

    Raises ConnectionError where nobody is there any more.
    """

    def __init__(self, end: socket.socket, network: Channel, back: str, start: float) -> None:
        end.setblocking(False)
        self.end, self.network, self.back, self.start = end, network, back, start
        self._sent, self._heard, self._waiting = 0, start, list[Packet]()

    @property
    def now(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.start

    def send(self, sent_at: float, values: np.ndarray) -> None:
        """Send the next packet."""
        with suppress(BlockingIOError):  # it is lost
            self.end.send(np.concatenate([(self._sent, sent_at), values]).tobytes())
        self._sent += 1

    def until(self, t: float) -> None:
        """Receive packets until a time since the start."""
        while (left := t - self.now) > 0:
            if select.select([self.end], [], [], left)[0]:
                self._receive()

    def arrived(self, t: float) -> list[Packet]:
        """The packets that arrive up to a time since the start, in their order."""
        self._receive()
        if time.monotonic() - self._heard > PATIENCE:
            raise ConnectionError("rig: the other side is silent")
        packets = []
        while self._waiting and self._waiting[0].arrival <= t:
            packets.append(heapq.heappop(self._waiting))
        return packets

    def _receive(self) -> None:
        with suppress(BlockingIOError):  # no more of them
            while True:
                number, sent_at, *values = np.frombuffer(self.end.recv(LONGEST)).tolist()
                self._heard = time.monotonic()
                due = self.network.arrival(self.back, int(number), sent_at)
                if due < math.inf:  # what this machine needs itself may be more than the network's delay
                    packet = Packet(max(due, self.now), int(number), sent_at, np.array(values))
                    heapq.heappush(self._waiting, packet)


def pair() -> tuple[socket.socket, socket.socket]:
    """Two sockets of localhost, each connected to the other."""
    ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for end in ends:
        end.bind(("127.0.0.1", 0))
    for end, other in zip(ends, reversed(ends), strict=True):
        end.connect(other.getsockname())
    return ends[0], ends[1]
