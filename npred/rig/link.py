"""One end of the two: numbered and stamped packets by UDP, each handed over when the network says that it arrives.

The clock is time.monotonic, common to all processes of a machine, from a start that both ends agree on.
"""

import heapq
import math
import select
import socket
import time
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from npred.errors import NpredError
from npred.rig.network import Channel

PATIENCE = 2.0  # s without any packet, lost ones too, after which the other side is gone …
COMPILING = 120.0  # … and before the start
AHEAD = 0.1  # s from the agreement to the start
HELLO, START, END = -1, -2, -3  # instead of a number: these arrive at once
LONGEST = 65507  # bytes of a packet


class GoneError(NpredError):
    """The other side is gone."""


class Packet(NamedTuple):
    """What arrived: its times in seconds since the start, and its values."""

    arrival: float
    number: int
    sent_at: float
    values: np.ndarray


class UdpLink:
    """Sends packets of one way and receives those of the other. Raises GoneError where nobody is there any more."""

    def __init__(self, end: socket.socket, network: Channel, way: str, back: str) -> None:
        self.end, self.network, self.way, self.back = end, network, way, back
        end.setblocking(False)
        self.start, self.sent, self.ended = 0.0, 0, False
        self._heard, self._waiting = time.monotonic(), list[tuple[float, int, float, bytes]]()

    @property
    def now(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.start

    def send(self, sent_at: float, values: np.ndarray) -> None:
        """Send the next packet."""
        self._send(self.sent, sent_at, values)
        self.sent += 1

    def leave(self) -> None:
        """Say that this is the end, to whom it may reach."""
        with suppress(GoneError):
            self._send(END, 0.0, np.zeros(0))

    def lead(self) -> None:
        """Wait for the other side, and say when the start is."""
        while self._told(HELLO) is None:
            pass
        self.start = time.monotonic() + AHEAD
        self._send(START, self.start, np.zeros(0))
        self._heard = self.start

    def follow(self) -> None:
        """Say that this side is ready, until the other one says when the start is."""
        while True:
            self._send(HELLO, 0.0, np.zeros(0))
            if (start := self._told(START)) is not None:
                self.start = self._heard = start
                return

    def until(self, t: float) -> None:
        """Receive what comes until a time since the start."""
        while (left := t - self.now) > 0 and not self.ended:
            if select.select([self.end], [], [], left)[0]:
                self._receive()

    def arrived(self, t: float) -> list[Packet]:
        """The packets that arrive up to a time since the start, in their order."""
        self._receive()
        if time.monotonic() - self._heard > PATIENCE:
            raise GoneError("rig: the other side is silent")
        packets = []
        while self._waiting and self._waiting[0][0] <= t:
            arrival, number, sent_at, values = heapq.heappop(self._waiting)
            packets.append(Packet(arrival, number, sent_at, np.frombuffer(values)))
        return packets

    def _receive(self) -> None:
        while (packet := self._next()) is not None:
            number, sent_at = int(packet[0]), float(packet[1])
            self._heard, self.ended = time.monotonic(), self.ended or number == END
            if number < 0:
                continue
            due = self.network.arrival(self.back, number, sent_at)
            if due < math.inf:  # what this machine needs itself may be more than the network's delay
                heapq.heappush(self._waiting, (max(due, self.now), number, sent_at, packet[2:].tobytes()))

    def _told(self, what: int) -> float | None:
        """The time in a packet of that kind, of those that come within a moment."""
        if time.monotonic() - self._heard > COMPILING:
            raise GoneError("rig: the other side did not start")
        select.select([self.end], [], [], 0.02)
        packet = self._next()
        return float(packet[1]) if packet is not None and packet[0] == what else None

    def _next(self) -> np.ndarray | None:
        try:
            return np.frombuffer(self.end.recv(LONGEST))
        except BlockingIOError:
            return None
        except ConnectionError:
            raise GoneError("rig: the other side is gone") from None

    def _send(self, number: int, sent_at: float, values: np.ndarray) -> None:
        try:
            self.end.send(np.concatenate([(number, sent_at), values]).tobytes())
        except BlockingIOError:
            pass  # lost
        except ConnectionError:
            raise GoneError("rig: the other side is gone") from None


def pair() -> tuple[socket.socket, socket.socket]:
    """Two sockets of localhost, each connected to the other."""
    ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for end in ends:
        end.bind(("127.0.0.1", 0))
    for end, other in zip(ends, reversed(ends), strict=True):
        end.connect(other.getsockname())
    return ends[0], ends[1]
