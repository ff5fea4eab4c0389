"""From a network's table of the pipeline file to an untrained operator of a plant."""

import torch
from torch import nn

from npred.config import FNO, DeepONet, Training
from npred.errors import ConfigError
from npred.operators.base import Operator
from npred.operators.deeponet import DeepONetwork
from npred.operators.fno import FNOnetwork
from npred.operators.scaling import Scaling
from npred.plants.base import Plant


def build(config: Training, plant: Plant, scaling: Scaling) -> Operator:
    """An untrained operator: `config` (DeepONet or FNO) gives sizes and anchor, torch's generator the weights.

    Raises ConfigError for the anchor `equilibrium` on a plant without one.
    """
    network = _network(config, plant.n, plant.m, 2 if plant.clocked else 0)
    return Operator(network, scaling, config.anchor, *_rest(config, plant))


def _network(config: Training, n: int, m: int, clock: int) -> nn.Module:
    if isinstance(config, DeepONet):
        return DeepONetwork(config, n, m, clock)
    if isinstance(config, FNO):
        return FNOnetwork(config, n, m, clock)
    raise ConfigError(f"train: expected a table deeponet or fno, got {type(config).__name__}; use one of those")


def _rest(config: Training, plant: Plant) -> tuple[torch.Tensor, torch.Tensor]:
    if plant.rest:
        return _float32(plant.rest[0]), _float32(plant.rest[1])
    if config.anchor == "equilibrium":
        raise ConfigError(f"anchor: expected a plant with an equilibrium, {plant.name} has none; use 'initial'")
    return torch.zeros(plant.n), torch.zeros(plant.m)


def _float32(values: object) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32)
