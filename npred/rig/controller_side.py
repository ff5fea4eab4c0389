"""The controller of a rig: one call each dt on the real clock, with the newest sample that has arrived."""

import gc
import math
import os
import signal
import socket
from pathlib import Path

import numpy as np

from npred.errors import DivergedError
from npred.loop.controller import Controller
from npred.rig import clock
from npred.rig.link import GoneError, Packet, UdpLink
from npred.rig.log import OVER, LogFile
from npred.rig.network import Channel


def run(controller: Controller, end: socket.socket, network: Channel, seconds: float, path: Path, parent: int) -> None:
    """Be the controller for so many seconds, or until the plant or the parent is gone or SIGTERM comes; the log says
    which."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asked: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: asked.append(number))
    link = UdpLink(end, network, "commands", "samples")
    gc.disable()
    with LogFile(path, controller) as log:
        loop = Calls(controller, link, log)
        try:
            link.lead()
            k = 0
            while k * controller.dt < seconds and not asked and os.getppid() == parent:
                loop.call(k * controller.dt)
                k = max(k + 1, math.ceil(link.now / controller.dt))  # an overrun skips those that are past
            log.end("interrupted" if asked else OVER if os.getppid() == parent else "nobody waits for it")
        except GoneError:
            log.end("the plant is gone")
        finally:
            link.leave()


class Calls:
    """The calls of a controller, each written to the log with its samples."""

    def __init__(self, controller: Controller, link: UdpLink, log: LogFile) -> None:
        self.controller, self.link, self.log = controller, link, log
        self._newest, self._U = -math.inf, np.zeros(controller.plant.m)

    def call(self, due: float) -> None:
        """Wait until it is due, take the samples that have arrived, and send U."""
        clock.wait(self.link.start + due)
        t = self.link.now
        packets = self.link.arrived(t)
        new = [packet for packet in packets if packet.sent_at > self._newest]
        newest = max(new, key=lambda packet: packet.sent_at, default=None)
        if newest or self._newest > -math.inf:  # before the first sample there is nothing to begin from
            refused = self._step(t, newest)
            self.link.send(t, self._U)
            self.log.call(t, self._U, self.controller.status, newest is not None, refused, t - due, self.link.now - t)
        for packet in packets:
            self.log.sample(packet)

    def _step(self, t: float, packet: Packet | None) -> bool:
        """Set U; whether the sample was refused."""
        n = len(self.controller.outputs)
        sample = {} if packet is None else {"X": packet.values[:n], "sampled_at": packet.sent_at}
        self._newest = packet.sent_at if packet else self._newest
        try:
            self._U = self.controller.step(t=t, **sample).copy()
        except DivergedError:  # hold the last U
            return True
        return False
