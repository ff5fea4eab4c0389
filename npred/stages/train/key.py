"""What the key of a network holds."""

from typing import Any

from npred import registry
from npred.config import Network, Pipeline
from npred.stages.configuration import table


def configuration(config: Pipeline, model: str | None, device: str) -> dict[str, Any]:
    """The network's table; a network of a file enters by what that holds."""
    assert model is not None
    section = config.train.table(model)
    identity = {"network": registry.NETWORKS.identity(section.architecture)} if isinstance(section, Network) else {}
    return {"train": {model: table(section) | identity}}
