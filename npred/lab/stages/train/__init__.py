"""Train the networks; each is one result in the store."""

from typing import TYPE_CHECKING, Any

from npred.base import registry
from npred.base.progress import counted
from npred.lab.scheduler.declaration import Slices, Stage

if TYPE_CHECKING:
    from npred.lab.config.results import Trained

STAGE = Stage(
    __name__,
    version=3,
    upstream=("generate",),
    result_class="npred.lab.config.results:Trained",
    per_network=True,
    needs="torch",
)


def key(slices: Slices) -> dict[str, Any]:
    """The network's table; a network of a file enters by its content."""
    from npred.lab.config import Network
    from npred.lab.scheduler.configuration import table

    assert slices.model is not None
    section = slices.config.train.table(slices.model)
    identity = {"network": registry.NETWORKS.identity(section.architecture)} if isinstance(section, Network) else {}
    return {"train": {slices.model: table(section) | identity}}


def summary(result: "Trained", width: int | None = None) -> str:
    """In a line; train.py brings torch."""
    size = f"{result.parameters} parameters, {counted(result.epochs, 'epochs')} of {counted(result.samples, 'samples')}"
    return f"{result.model}: {size}; held-out rollouts: MSE {result.mse:.3g}, sup error {result.eps_sup:.3g}"
