"""The plant of a rig: the truth, integrated on the real clock, that applies commands when they arrive."""

import math
import socket
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection

import numpy as np

from npred import randomness
from npred.config import Evaluate
from npred.loop.engine import advance_kernel
from npred.loop.measurement import Sensors
from npred.observers import Observer
from npred.plants import Plant
from npred.predictors import RK4
from npred.rig import clock
from npred.rig.network import Channel, Packet, UdpLink

FINE = 4  # steps of the integration in a control step, at least


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
                self._apply(self._queue.popleft())
            if self.t >= t:
                return self.X[:, 0]
            next_change = self._queue[0].arrival + self.D if self._queue else math.inf
            self._step(min(t, next_change, self.t + self.step))

    @property
    def age(self) -> float:
        """The mean over time of how old the acting command is: the delay and half a control step, and more where
        commands are lost; NaN before the first."""
        return self._ages / (self.t - self._since) if self.t > self._since else math.nan

    def _apply(self, packet: Packet) -> None:
        if math.isnan(self._since):
            self._since = self.t
        self.U[:, 0], self._sent_at = packet.values, packet.sent_at

    def _step(self, end: float) -> None:
        dt = end - self.t
        U = self.U + self.push.amplitude * math.sin(self.push.omega * (self.t + dt / 2))
        self._advance(self.X, U, U, self._share, dt, self.t, self.plant.p)
        if self.t >= self._since:
            self._ages += dt * (self.t + dt / 2 - self._sent_at)
        self.t = end


def sensed(X: np.ndarray, sensors: Sensors, rng: np.random.Generator) -> np.ndarray:
    """A sample of X (n,) with the noise, bias and resolution of npred.Measurement."""
    Y = X * (1 + np.asarray(sensors.noise) * rng.standard_normal(X.shape))
    Y = Y + np.asarray(sensors.absolute) * rng.standard_normal(X.shape) + np.asarray(sensors.bias)
    step = np.broadcast_to(sensors.resolution, X.shape).astype(float)
    return np.where(step > 0, np.round(Y / np.where(step > 0, step, 1.0)) * step, Y)


def run(
    plant: Plant, table: Evaluate, U0: np.ndarray, observer: Observer | None, end: socket.socket, network: Channel,
    parent: Connection,
) -> None:  # fmt: skip
    """Be the plant, until the controller or the parent is gone; samples are what the `observer` is to get of X.

    The mean age of the commands and X itself go with them, for the log.
    """
    truth, period = DelayedPlant(plant, table, U0), table.measurement.period or table.dt
    link, k = UdpLink(end, network, "commands", clock.agreed(parent)), 0
    with suppress(ConnectionError):
        while not parent.poll():
            t = k * period
            link.until(t)
            for packet in link.arrived(t):
                truth.command(packet)
            X = truth.to(t)
            rng = randomness.generator(network.seed, "sensors", k)
            Y = sensed(observer.measured(X, t) if observer else X, table.measurement, rng)
            link.send(t, np.concatenate([Y, [truth.age - table.dt / 2], X]))
            k += 1
