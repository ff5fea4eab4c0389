"""From a network's table of the pipeline file to an untrained operator of a plant."""

import torch

from npred.config import Training
from npred.errors import ConfigError
from npred.operators.base import Operator
from npred.operators.scaling import Scaling
from npred.plants.base import Plant
from npred.registry import NETWORKS
from npred.symbolic import source_lines

NODES = 5  # of the tiny batch that a network is asked on


def build(config: Training, plant: Plant, scaling: Scaling) -> Operator:
    """An untrained operator: `config` gives network, sizes and anchor, torch's generator the weights.

    Raises ConfigError for an unknown network, and for the anchor `equilibrium` on a plant without one.
    """
    network = NETWORKS.load("network", config.architecture)(plant.n, plant.m, _clock(plant), **config.arguments)
    return Operator(network, scaling, config.anchor, *_rest(config, plant))


def checked(config: Training, plant: Plant, scaling: Scaling) -> Operator:
    """An untrained operator whose network has answered a tiny batch, for it may be anybody's.

    Raises ConfigError, in one line, where it cannot be made, fails, or answers in another shape.
    """
    name, inputs = config.architecture, (torch.zeros(2, plant.n + _clock(plant)), torch.zeros(2, NODES, plant.m))
    try:
        operator = build(config, plant, scaling)
        shapes = [tuple(operator.network(*inputs, torch.zeros(2), stride).shape) for stride in (1, 2)]
    except Exception as error:
        if isinstance(error, ConfigError):
            raise
        reason = source_lines.one_line(error)
        cure = "let forward take X, u, D_hat, stride"
        raise ConfigError(f"network {name}: failed on two samples on {NODES} nodes: {reason}; {cure}") from None
    expected = [(2, len(range(0, NODES, stride)), plant.n) for stride in (1, 2)]
    if shapes != expected:
        raise ConfigError(
            f"network {name}: expected forward to return (B, nodes, n), {expected[0]} for {NODES} nodes and "
            f"{expected[1]} with stride 2, got {shapes[0]} and {shapes[1]}; return those"
        )
    return operator


def _clock(plant: Plant) -> int:
    return 2 if plant.phased else 0


def _rest(config: Training, plant: Plant) -> tuple[torch.Tensor, torch.Tensor]:
    if plant.rest:
        return _float32(plant.rest[0]), _float32(plant.rest[1])
    if config.anchor == "equilibrium":
        raise ConfigError(f"anchor: expected a plant with an equilibrium, {plant.name} has none; use 'initial'")
    return torch.zeros(plant.n), torch.zeros(plant.m)


def _float32(values: object) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32)
