"""The flags of `npred rig` that the work behind it reads."""

from dataclasses import dataclass
from typing import Annotated

from npred.cli.options import WATCHDOG, Piped, flag


@dataclass(frozen=True)
class Rigged(Piped):
    """Flags of `npred rig`: its length, its network, and the parts of the controller that are not in [evaluate]."""

    seconds: Annotated[float, flag("How long it runs, in seconds.")] = 60.0
    latency: Annotated[float, flag("Delay of the network in each direction, in seconds; the plant's D adds to it.")] = (
        0.12
    )
    jitter: Annotated[float, flag("Largest deviation of the latency, in seconds.")] = 0.02
    loss: Annotated[float, flag("Share of packets that are lost.")] = 0.0
    reorder: Annotated[float, flag("Share of packets that take twice as long.")] = 0.0
    stops: Annotated[float, flag("How often per minute the network stands still for 200 ms.")] = 0.0
    seed: Annotated[int, flag("Seed of network and sensor noise.", least=0)] = 0
    watchdog: Annotated[str, WATCHDOG] = ""
    model: Annotated[str | None, flag("Predict with a trained network, as deeponet.")] = None
