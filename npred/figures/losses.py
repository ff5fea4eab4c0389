"""Learning curves of networks: the loss, and the errors on held-out rollouts, epoch by epoch."""

from dataclasses import replace
from functools import partial
from typing import Any

from npred.figures.figure import Key, Panel, Plate
from npred.figures.style import log, look
from npred.results import Contender

Epochs = list[dict[str, float]]
SHOWN = {"loss": "training loss", "mse": "held-out mean square", "eps_sup": "held-out sup error ε"}


def learning(histories: dict[Contender, Epochs]) -> Plate:
    """The metrics of each network's epochs, as its training left them."""
    panels = [Panel(title, _alt(title, key, histories), partial(_curves, key, histories))
              for key, title in SHOWN.items()]  # fmt: skip
    caption = (
        "One point per epoch. The loss differs by network; the errors are in state units, on the rollouts that the "
        "data hold out."
    )
    solid = tuple(Key(network.label, replace(look(network), dash=())) for network in histories)  # dashes hide roughness
    return Plate("learning", "Training", caption, tuple(panels), solid)


def _curves(key: str, histories: dict[Contender, Epochs], axis: Any) -> None:
    for network, epochs in histories.items():
        solid = replace(look(network), dash=(), marker="" if len(epochs) > 1 else "o")  # one point makes no line
        axis.plot([row["epoch"] for row in epochs], [row[key] for row in epochs], **solid.line)
    axis.set_xlabel("epoch")
    log(axis, "y")


def _alt(title: str, key: str, histories: dict[Contender, Epochs]) -> str:
    ends = "; ".join(f"{network.label} {rows[0][key]:.2e} to {rows[-1][key]:.2e} in {len(rows)} epochs"
                     for network, rows in histories.items())  # fmt: skip
    return f"{title}: {ends}."
