"""The plant of a rig: the truth, integrated on the real clock, that applies commands when they arrive."""

import math
import os
import signal
import socket
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from npred import randomness
from npred.config import Disturbance, Sensors
from npred.loop.engine import advance_kernel
from npred.plants import Plant
from npred.predictors import RK4
from npred.rig.link import PATIENCE, GoneError, Packet, UdpLink
from npred.rig.network import Channel


@dataclass(frozen=True)
class Truth:
    """The plant as it is: from X0 (n,), with U0 (m,) before the first command; each command acts D seconds after it
    arrives, and the sensors sample every `period` seconds. `step` is the longest one of the integration.
    """

    plant: Plant
    X0: np.ndarray
    U0: np.ndarray
    D: float
    period: float
    step: float
    sensors: Sensors = field(default_factory=Sensors)
    disturbance: Disturbance = field(default_factory=Disturbance)
    seed: int = 0


class DelayedPlant:
    """X' = f(X, U), U the newest of the commands that arrived D seconds ago, by RK4 with a step at each change of U."""

    def __init__(self, truth: Truth) -> None:
        plant = truth.plant
        self.truth, self.t = truth, 0.0
        self.X, self.U = np.array(truth.X0, dtype=float)[:, None], np.array(truth.U0, dtype=float)[:, None]
        self._advance, self._share = advance_kernel(plant, RK4), np.ones((plant.m, 1))
        self._queue: deque[Packet] = deque()
        self._last, self._sent_at, self._since = -1, math.nan, math.nan
        self._ages = self._delays = 0.0
        self.applied = 0

    def command(self, packet: Packet) -> None:
        """Take a command, in the order of arrival; one that is older than another before it is dropped."""
        if packet.number > self._last:
            self._last = packet.number
            self._queue.append(packet)

    def to(self, t: float) -> np.ndarray:
        """Go on to a time; X (n,) there."""
        while True:
            while self._queue and self._queue[0].arrival + self.truth.D <= self.t:
                self._apply(self._queue.popleft())
            if self.t >= t:
                return self.X[:, 0]
            next_change = self._queue[0].arrival + self.truth.D if self._queue else math.inf
            self._step(min(t, next_change, self.t + self.truth.step))

    @property
    def delay(self) -> float:
        """The mean time from the stamp of a command to where it acts, of those that did; NaN before."""
        return self._delays / self.applied if self.applied else math.nan

    @property
    def age(self) -> float:
        """The mean over time of how old the acting command is: the delay and half a control step, and more where
        commands are lost."""
        return self._ages / (self.t - self._since) if self.t > self._since else math.nan

    def _apply(self, packet: Packet) -> None:
        if not self.applied:
            self._since = self.t
        self.U[:, 0], self._sent_at = packet.values, packet.sent_at
        self._delays += self.t - packet.sent_at
        self.applied += 1

    def _step(self, end: float) -> None:
        dt, push = end - self.t, self.truth.disturbance
        U = self.U + push.amplitude * math.sin(push.omega * (self.t + dt / 2))
        self._advance(self.X, U, U, self._share, dt, self.t, self.truth.plant.p)
        if self.applied:
            self._ages += dt * (self.t + dt / 2 - self._sent_at)
        self.t = end


def sensed(X: np.ndarray, sensors: Sensors, rng: np.random.Generator) -> np.ndarray:
    """A sample of X (n,) with the noise, bias and resolution of npred.Measurement."""
    Y = X * (1 + np.asarray(sensors.noise) * rng.standard_normal(X.shape))
    Y = Y + np.asarray(sensors.absolute) * rng.standard_normal(X.shape) + np.asarray(sensors.bias)
    step = np.broadcast_to(sensors.resolution, X.shape).astype(float)
    return np.where(step > 0, np.round(Y / np.where(step > 0, step, 1.0)) * step, Y)


def run(truth: Truth, end: socket.socket, network: Channel, seconds: float, parent: int) -> None:
    """Be the plant, until the controller says that it is the end, or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started both sides ends them
    plant, link = DelayedPlant(truth), UdpLink(end, network, "samples", "commands")
    try:
        link.follow()
        for k in range(int((seconds + PATIENCE) / truth.period) + 1):
            t = k * truth.period
            link.until(t)
            for packet in link.arrived(t):
                plant.command(packet)
            if link.ended or os.getppid() != parent:
                return
            Y = sensed(plant.to(t), truth.sensors, randomness.generator(truth.seed, "sensors", k))
            link.send(t, np.append(Y, (plant.delay, plant.age)))
    except GoneError:
        return
