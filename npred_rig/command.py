"""The command `npred rig`, as the command line declares it: its work is imported when it is called."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from npred.cli.options import WATCHDOG, Piped, flag


@dataclass(frozen=True)
class Rigged(Piped):
    """Flags of `npred rig`: its length, its network, and the parts of the controller that are not in [evaluate]."""

    seconds: Annotated[float, flag("How long it runs.")] = 60.0
    latency: Annotated[float, flag("Delay of the network in each direction, in seconds; the plant's D adds to it.")] = (
        0.12
    )
    jitter: Annotated[float, flag("The largest deviation of the latency, in seconds.")] = 0.02
    loss: Annotated[float, flag("Share of packets that are lost.")] = 0.0
    reorder: Annotated[float, flag("Share of packets that take twice their time.")] = 0.0
    stops: Annotated[float, flag("Times per minute that the network stands still for 200 ms.")] = 0.0
    seed: Annotated[int, flag("Seed of network and sensor noise.", least=0)] = 0
    watchdog: Annotated[str, WATCHDOG] = ""
    model: Annotated[str | None, flag("A trained network that predicts, as deeponet.")] = None


def rig(
    options: Rigged,
    *,
    log: Annotated[Path | None, flag("The log that is written; NAME-rig.csv here by default.", word="FILE.csv")] = None,
    figure: Annotated[Path | None, flag("A figure of the log: SVG, PDF or PNG.", word="FILE")] = None,
) -> None:
    """Plant and controller of the evaluated loop as two processes on a real clock, with a network between them."""
    from npred_rig.rig import rig

    rig(options, log, figure)
