"""The controller of a rig: one call each dt on the real clock, with the newest sample that has arrived."""

import gc
import math
import socket
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from npred.errors import DivergedError
from npred.loop.controller import Controller
from npred.rig import clock
from npred.rig.log import CALL, OVER, SAMPLE, LogFile, truth
from npred.rig.network import Channel, Packet, UdpLink


def run(
    controller: Controller, end: socket.socket, network: Channel, seconds: float, path: Path, parent: Connection
) -> None:
    """Be the controller for so many seconds, or until the plant or the parent is gone; the log says which."""
    link = UdpLink(end, network, "samples", clock.agreed(parent))
    gc.disable()
    log, dt, k = LogFile(path, controller), controller.dt, 0
    calls = Calls(controller, link, log)
    try:
        while k * dt < seconds and not parent.poll():
            calls.call(k * dt)
            k = max(k + 1, math.ceil(link.now / dt))  # an overrun skips those that are past
        log.end("interrupted" if k * dt < seconds else OVER if calls.begun else "no sample arrived")
    except ConnectionError:
        log.end("the plant is gone")


class Calls:
    """The calls of a controller, each written to the log with its samples."""

    def __init__(self, controller: Controller, link: UdpLink, log: LogFile) -> None:
        self.controller, self.link, self.log = controller, link, log
        self.begun, self._failed, self._U = False, 0, np.zeros(controller.plant.m)

    def call(self, due: float) -> None:
        """Wait until it is due, take the samples that have arrived, and send U."""
        clock.wait(self.link.start + due)
        t, n = self.link.now, len(self.controller.outputs)
        packets = self.link.arrived(t)
        self.begun = self.begun or bool(packets)
        if self.begun:  # before the first sample there is nothing to begin from
            self._step(t, max(packets, key=lambda packet: packet.sent_at, default=None), n)
            self.link.send(t, self._U)
            status, took = self.controller.status, self.link.now - t
            counts = (status.refused + self._failed, status.handed_over)
            values = (*self._U, status.D_hat, status.D_hat_spread, status.age, *counts, t - due, took)
            self.log.row(t, (*self.controller.plant.inputs, *CALL), values)
        for packet in packets:
            values = (*packet.values[:n], packet.number, packet.arrival, *packet.values[n:])
            self.log.row(packet.sent_at, (*self.controller.outputs, *SAMPLE, *truth(self.controller.plant)), values)

    def _step(self, t: float, newest: Packet | None, n: int) -> None:
        sample = {"X": newest.values[:n], "sampled_at": newest.sent_at} if newest else {}
        try:
            self._U = self.controller.step(t=t, **sample).copy()
        except DivergedError:  # hold the last U
            self._failed += 1
