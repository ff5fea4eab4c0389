"""Both sides of a rig, each a process on time.monotonic, the clock that all processes of a machine have in common."""

import gc
import math
import signal
import socket
import time
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from npred.base import randomness
from npred.base.errors import DivergedError
from npred.estimation.observers import Observer
from npred.lab.config import Evaluate
from npred.lab.report.terminal import interruption
from npred.loop.controller import Controller
from npred.loop.engine import advance_kernel
from npred.loop.settable import Piece
from npred.plants import Plant
from npred.prediction.methods import RK4
from npred_rig.log import CALL, OVER, SAMPLE, LogFile, truth
from npred_rig.network import Channel, Packet, UdpLink

SPIN = 2e-4  # s before the time, from which on the clock is read without sleeping
FINE = 4  # steps of the integration in a control step, at least


def agreed(parent: Connection) -> float:
    """Say that this process is ready; when all begin. Whoever started it ends it, so that the log has its end: it
    ignores signals, which a terminal or `timeout` sends to all.
    """
    for number in interruption.SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    try:
        parent.send(None)
        return parent.recv()
    except (EOFError, OSError):  # it is gone
        raise SystemExit(1) from None


def wait(until: float) -> None:
    """Sleep until time.monotonic() is `until`, the last part of it awake."""
    while (left := until - time.monotonic()) > 0:
        if left > SPIN:
            time.sleep(left - SPIN)


def only_wait(dt: float, seconds: float, parent: Connection) -> None:
    """Send how late, in seconds, a process comes that waits for each dt and does nothing: the machine's own stops."""
    start, late = agreed(parent), []
    for k in range(1, int(seconds / dt) + 1):
        if parent.poll():
            return
        wait(start + k * dt)
        late.append(time.monotonic() - start - k * dt)
    parent.send(np.array(late))


def control(
    controller: Controller, course: list[Piece], end: socket.socket, network: Channel, seconds: float, path: Path,
    parent: Connection,
) -> None:  # fmt: skip
    """Be the controller for so many seconds, or until the plant or the parent is gone; the log says which.

    Each dt it sets what `course` has for this time, takes the newest sample that has arrived, sends U, and writes the
    call and its samples to the log.
    """
    link = UdpLink(end, network, "samples", agreed(parent))
    gc.disable()
    log, plant, dt, n = LogFile(path, controller), controller.plant, controller.dt, len(controller.outputs)
    U, begun, failed, k = np.zeros(plant.m), False, 0, 0
    try:
        while k * dt < seconds and not parent.poll():
            wait(link.start + k * dt)
            t = link.now
            packets = link.arrived(t)
            begun = begun or bool(packets)
            while course and course[0].start <= t:
                controller.set(**course.pop(0).values)
            if begun:  # before the first sample there is nothing to begin from
                newest = max(packets, key=lambda packet: packet.sent_at, default=None)
                sample = {"X": newest.values[:n], "sampled_at": newest.sent_at} if newest else {}
                try:
                    U = controller.step(t=t, **sample).copy()
                except DivergedError:  # hold the last U
                    failed += 1
                link.send(t, U)
                status, took = controller.status, link.now - t
                counts = (status.refused + failed, status.handed_over)
                values = (*U, status.D_hat, status.D_hat_spread, status.age, *counts, t - k * dt, took)
                log.row(t, (*plant.inputs, *CALL), values)
            for packet in packets:
                values = (*packet.values[:n], packet.number, packet.arrival, *packet.values[n:])
                log.row(packet.sent_at, (*controller.outputs, *SAMPLE, *truth(plant)), values)
            k = max(k + 1, math.ceil(link.now / dt))  # an overrun skips those that are past
        log.end("interrupted" if k * dt < seconds else OVER if begun else "no sample arrived")
    except ConnectionError:
        log.end("the plant is gone")


class DelayedPlant:
    """X' = f(X, U), U the newest of the commands that arrived D seconds ago, by RK4 with a step at each change of U.

    D, X0 and the disturbance are those of [evaluate], U0 (m,) acts before the first command.
    """

    def __init__(self, plant: Plant, table: Evaluate, U0: np.ndarray) -> None:
        self.plant, self.D, self.push, self.step, self.t = plant, table.D, table.disturbance, table.dt / FINE, 0.0
        self.X, self.U = np.array(table.X0 or plant.target(0.0))[:, None], np.array(U0, dtype=float)[:, None]
        self._advance, self._share = advance_kernel(plant, RK4), np.ones((plant.m, 1))
        self._queue: deque[Packet] = deque()
        self._last, self._sent_at, self._since, self._ages = -1, math.nan, math.nan, 0.0

    def command(self, packet: Packet) -> None:
        """Take a command, in the order of arrival; one that is older than another before it is dropped."""
        if packet.number > self._last:
            self._last = packet.number
            self._queue.append(packet)

    def to(self, t: float) -> np.ndarray:
        """Go on to a time; X (n,) there."""
        while True:
            while self._queue and self._queue[0].arrival + self.D <= self.t:
                packet = self._queue.popleft()
                self.U[:, 0], self._sent_at = packet.values, packet.sent_at
                self._since = self.t if math.isnan(self._since) else self._since
            if self.t >= t:
                return self.X[:, 0]
            next_change = self._queue[0].arrival + self.D if self._queue else math.inf
            end = min(t, next_change, self.t + self.step)
            dt, middle = end - self.t, self.t + (end - self.t) / 2
            U = self.U + self.push.amplitude * math.sin(self.push.omega * middle)
            self._advance(self.X, U, U, self._share, dt, self.t, self.plant.p)
            if self.t >= self._since:
                self._ages += dt * (middle - self._sent_at)
            self.t = end

    @property
    def age(self) -> float:
        """The mean over time of how old the acting command is: the delay and half a control step, and more where
        commands are lost; NaN before the first."""
        return self._ages / (self.t - self._since) if self.t > self._since else math.nan


def simulate(
    plant: Plant, table: Evaluate, U0: np.ndarray, observer: Observer | None, end: socket.socket, network: Channel,
    parent: Connection,
) -> None:  # fmt: skip
    """Be the plant, until the controller or the parent is gone; samples are the outputs that the `observer` gets.

    The mean age of the commands and X itself go with them, for the log.
    """
    state, period = DelayedPlant(plant, table, U0), table.measurement.period or table.dt
    link, k = UdpLink(end, network, "commands", agreed(parent)), 0
    with suppress(ConnectionError):
        while not parent.poll():
            t = k * period
            link.until(t)
            for packet in link.arrived(t):
                state.command(packet)
            X = state.to(t)
            rng = randomness.generator(network.seed, "sensors", k)
            Y = table.measurement.sampled(observer.measured(X, t) if observer else X, rng)
            link.send(t, np.concatenate([Y, [state.age - table.dt / 2], X]))
            k += 1
