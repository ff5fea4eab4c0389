"""What a file of weights has to hold, and that it is read without torch as with it."""

import inspect
from pathlib import Path

import numpy as np
import pytest
import torch
from operator_samples import EVERY, PLANT, SMALL, operator, phased, samples

from npred.base import registry
from npred.base.errors import ConfigError
from npred.base.registry import NETWORKS
from npred.lab.config import FNO, DeepONet
from npred.lab.training import operators
from npred.lab.training.operators import Scaling, build
from npred.networks import layouts
from npred.networks.fused import lowering
from npred.networks.weights import Weights, read

LAID_OUT = [name for name, entry in NETWORKS.builtin.items() if entry.layout]


@pytest.mark.parametrize("config", [*SMALL, DeepONet(depth=1), FNO(layers=1), DeepONet(), FNO()])
@pytest.mark.parametrize("plant", [PLANT, phased()[0]], ids=lambda plant: plant.name)
def test_a_layout_is_that_of_the_torch_network(config, plant):
    torch_network = build(config, plant, Scaling(plant.n, plant.m)).network
    layout = registry.attribute(NETWORKS.builtin[config.architecture].layout)
    shapes = layout(plant.n, plant.m, 2 if plant.phased else 0, **config.arguments)
    assert shapes == {name: tuple(tensor.shape) for name, tensor in torch_network.state_dict().items()}
    scaling = {name: tuple(tensor.shape) for name, tensor in Scaling(3, 2).state_dict().items()}
    assert layouts.scaling(3, 2) == scaling


@pytest.mark.parametrize("name", LAID_OUT)
def test_a_layout_has_the_defaults_of_the_networks_class(name):
    entry = NETWORKS.builtin[name]
    of_class = inspect.signature(registry.attribute(entry.target)).parameters.values()
    of_layout = inspect.signature(registry.attribute(entry.layout)).parameters.values()
    assert [(p.name, p.default, p.kind) for p in of_class] == [(p.name, p.default, p.kind) for p in of_layout]


def test_what_is_lowered_has_a_layout():
    assert [name for name, entry in NETWORKS.builtin.items() if entry.lowering] == LAID_OUT


@pytest.mark.parametrize("config", SMALL, ids=lambda config: config.architecture)
@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_weights_are_those_of_the_operator_and_make_it_again(tmp_path: Path, config, precision):
    operators.save(tmp_path, operator(config, seed=3), config)
    weights = read(tmp_path, PLANT, precision=precision)
    assert isinstance(weights, Weights) and weights.weights() is weights
    dtype = torch.from_numpy(np.empty(0, dtype=precision)).dtype
    loaded = weights.module(PLANT)
    arrays = loaded.weights().arrays
    assert arrays.keys() == weights.arrays.keys() and loaded.weights().architecture == weights.architecture
    for name, array in weights.arrays.items():
        assert array.dtype == precision
        np.testing.assert_array_equal(array, arrays[name])
    data = samples(3)
    inputs = [torch.as_tensor(a, dtype=dtype) for a in (data.X, data.u, data.D_hat)]
    assert torch.equal(weights.module(PLANT)(*inputs), loaded(*inputs)) and loaded.module(PLANT) is loaded


@pytest.mark.parametrize("config", EVERY[2:], ids=lambda config: registry.short_name(config.architecture))
def test_a_network_without_a_fused_form_is_read_as_a_torch_module(tmp_path: Path, config):
    operators.save(tmp_path, operator(config), config)
    assert isinstance(read(tmp_path, PLANT, precision=np.float64, table=config).module(PLANT), operators.Operator)


def test_an_anchor_at_rest_needs_a_plant_with_one(tmp_path: Path):
    class Tracking:
        name, n, m, rest, phased = "tracking", 2, 1, None, False

    operators.save(tmp_path, operator(SMALL[0]), SMALL[0])
    with pytest.raises(ConfigError, match="anchor: expected a plant with an equilibrium, tracking has none"):
        read(tmp_path, Tracking())  # type: ignore[arg-type]


def test_a_class_of_another_module_is_no_built_in_network():
    model = operator(SMALL[0])
    assert model.architecture == "deeponet"
    for name in ("Mine", "deeponet"):
        model.network = type(name, (type(model.network),), {"__module__": "mine"})(2, 1)
        assert model.architecture == {"Mine": "Mine"}.get(name, "mine:deeponet") and not lowering(model)
