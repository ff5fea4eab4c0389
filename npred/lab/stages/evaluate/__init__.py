"""Measure each network's error on held-out data, and simulate closed loops with it."""

from typing import Any

from npred.lab.scheduler.declaration import Slices, Stage

STAGE = Stage(__name__, version=21, upstream=("generate", "train"), result_class="npred.lab.config.results:Evaluated")
HELD_OUT = ("test_share", "explore", "redraw", "spread", "explore_D", "explore_D_hat")


def key(slices: Slices) -> dict[str, Any]:
    """The table and the networks, the keys that draw held-out rows, and the labels of its figures.

    The same data may be held out in other shares.
    """
    from npred.lab.scheduler.configuration import table

    generate, section = slices.config.generate, {"evaluate": slices.loop("evaluate")}
    if not generate.data and (generate.explore or generate.redraw):
        section["generate"] = {name: value for name, value in table(generate).items() if name in HELD_OUT}
    return section | slices.networks | slices.box | slices.notation
