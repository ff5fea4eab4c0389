"""What a file of weights has to hold, and that it is read without torch as with it."""

import inspect
from importlib import import_module
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
from npred.networks.fused import lowering
from npred.networks.weights import Weights, read, shapes

FUSED = [name for name, entry in NETWORKS.builtin.items() if entry.fused]


@pytest.mark.parametrize("config", [*SMALL, DeepONet(depth=1), FNO(layers=1), DeepONet(), FNO()])
@pytest.mark.parametrize("plant", [PLANT, phased()[0]], ids=lambda plant: plant.name)
def test_a_file_of_weights_holds_the_arrays_of_the_torch_operator(config, plant):
    tensors = build(config, plant, Scaling(plant.n, plant.m)).state_dict()
    assert shapes(config, plant) == {name: tuple(tensor.shape) for name, tensor in tensors.items()}


@pytest.mark.parametrize("name", FUSED)
def test_shapes_have_the_defaults_of_the_networks_class(name):
    entry = NETWORKS.builtin[name]
    of_class = inspect.signature(registry.attribute(entry.target)).parameters.values()
    of_shapes = inspect.signature(import_module(entry.fused).shapes).parameters.values()
    assert [(p.name, p.default, p.kind) for p in of_class] == [(p.name, p.default, p.kind) for p in of_shapes]


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
    with pytest.raises(ConfigError, match="anchor: expected a plant with a rest, tracking has none"):
        read(tmp_path, Tracking())  # type: ignore[arg-type]


def test_a_class_of_another_module_is_no_built_in_network():
    model = operator(SMALL[0])
    assert model.architecture == "deeponet"
    for name in ("Mine", "deeponet"):
        model.network = type(name, (type(model.network),), {"__module__": "mine"})(2, 1)
        assert model.architecture == {"Mine": "Mine"}.get(name, "mine:deeponet") and not lowering(model)
