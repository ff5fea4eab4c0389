"""Every operator: anchors exact, any grid, a gradient in every parameter, files that read back to the bit."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from operator_samples import EVERY, NETWORKS, PLANT, SMALL, operator, samples, several_inputs, tensors

from npred.base.errors import ConfigError, StoreError
from npred.base.registry import short_name
from npred.lab.config import DeepONet, Training
from npred.lab.training.operators import Scaling, build, save
from npred.lab.training.operators.base import chebyshev
from npred.networks.weights import read

ANCHORS = pytest.mark.parametrize("anchor", ["none", "initial", "equilibrium"])


@NETWORKS
@ANCHORS
def test_shape_and_dtype(config, anchor):
    P_hat = operator(config, anchor=anchor)(*tensors(samples(7, nx=13)))
    assert P_hat.shape == (7, 13, 2) and P_hat.dtype == torch.float32


@NETWORKS
@pytest.mark.parametrize("anchor", ["initial", "equilibrium"])
def test_prediction_starts_at_the_state(config, anchor):
    X, u, D_hat = tensors(samples())
    P_hat = operator(config, anchor=anchor)(X, u, D_hat)
    assert torch.equal(P_hat[:, 0], X)
    assert (P_hat[:, -1] - X).abs().min() > 0


@NETWORKS
def test_rest_is_predicted_for_every_delay(config):
    model = operator(config, anchor="equilibrium")
    D_hat = torch.linspace(0.5, 4, 9)
    X, u = model.X_rest.expand(9, 2), model.u_rest.expand(9, 21, 1)
    assert torch.equal(model(X, u, D_hat), X[:, None].expand(9, 21, 2))
    away = operator(config, anchor="initial")(X, u, D_hat)
    assert (away[:, -1] - X).abs().amax(dim=1).min() > 1e-3


@NETWORKS
def test_equilibrium_anchor_is_the_difference_to_rest(config):
    X, u, D_hat = tensors(samples())
    anchored, free = operator(config, anchor="equilibrium"), operator(config, anchor="initial")
    rest = free.X_rest.expand_as(X)
    shift = free(rest, free.u_rest.expand_as(u), D_hat) - rest[:, None]
    torch.testing.assert_close(anchored(X, u, D_hat), free(X, u, D_hat) - shift, rtol=1e-5, atol=1e-5)


@NETWORKS
@torch.no_grad()
def test_interpolated_term_at_rest_is_close_to_the_exact_one(config):
    model, inputs = operator(config, anchor="equilibrium"), tensors(samples(200))
    torch.testing.assert_close(model(*inputs, rest_nodes=16), model(*inputs), rtol=1e-5, atol=1e-5)
    assert torch.equal(model(*inputs, rest_nodes=200), model(*inputs))


def test_interpolation_is_exact_for_polynomials_and_safe_for_one_delay():
    values = torch.linspace(0.3, 2, 50, dtype=torch.float64)
    points, weights = chebyshev(values, 6)
    torch.testing.assert_close(weights @ (points**5 - points), values**5 - values)
    points, weights = chebyshev(torch.full((9,), 1.5), 4)
    torch.testing.assert_close(weights @ points, torch.full((9,), 1.5))


@NETWORKS
@pytest.mark.parametrize("anchor", ["initial", "equilibrium"])
def test_without_a_delay_the_prediction_is_the_state(config, anchor):
    X, u, D_hat = tensors(samples())
    P_hat = operator(config, anchor=anchor)(X, u, torch.zeros_like(D_hat))
    assert torch.equal(P_hat, X[:, None].expand_as(P_hat))


@pytest.mark.parametrize("config", [SMALL[0], EVERY[3]], ids=lambda config: short_name(config.architecture))
@torch.no_grad()
def test_coarse_output_is_the_fine_one_at_its_nodes(config):
    model, inputs = operator(config), tensors(samples(5, nx=25))
    torch.testing.assert_close(model(*inputs, stride=4), model(*inputs)[:, ::4], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("config", EVERY[1:3], ids=lambda config: short_name(config.architecture))
@torch.no_grad()
def test_coarse_output_of_a_quadrature_is_near_the_fine_one_at_its_nodes(config):
    model, inputs = operator(config), tensors(samples(5, nx=101))
    torch.testing.assert_close(model(*inputs, stride=4), model(*inputs)[:, ::4], rtol=1e-3, atol=1e-4)


@NETWORKS
@ANCHORS
@torch.no_grad()
def test_two_grids_agree_to_second_order(config, anchor):
    model = operator(config, anchor=anchor).double()
    gaps = []
    for nx in (51, 101, 201):
        data = samples(nx=4 * nx - 3)
        X, u, D_hat = (torch.as_tensor(a) for a in (data.X, data.u, data.D_hat))
        gaps.append(float((model(X, u[:, ::4], D_hat) - model(X, u, D_hat)[:, ::4]).abs().max()))
    assert gaps[1] < 1e-3
    assert gaps[0] > 2.5 * gaps[1] > 6 * gaps[2]


@NETWORKS
@torch.no_grad()
def test_rows_do_not_see_each_other(config):
    model, inputs = operator(config), tensors(samples(9))
    order = torch.randperm(9, generator=torch.Generator().manual_seed(0))
    shuffled = model(*(values[order] for values in inputs), rest_nodes=9)
    torch.testing.assert_close(shuffled, model(*inputs, rest_nodes=9)[order], rtol=1e-5, atol=1e-5)


@NETWORKS
@torch.no_grad()
def test_several_inputs_and_a_grid_of_two_nodes(config):
    plant, data = several_inputs()
    model = build(config.model_copy(update={"anchor": "initial"}), plant, Scaling.of(data))
    X, u, D_hat = tensors(data)
    P = model(X, u, D_hat)
    assert P.shape == (4, 11, 3) and torch.equal(P[:, 0], X)
    assert model(X, u[:, [0, -1]], D_hat).shape == (4, 2, 3)
    for j in (0, 1):
        other = u.clone()
        other[..., j] += 1.0
        assert (model(X, other, D_hat) - P)[:, -1].abs().min() > 0


@NETWORKS
@ANCHORS
def test_every_parameter_has_a_gradient(config, anchor):
    model = operator(config, anchor=anchor)
    model(*tensors(samples())).square().mean().backward()
    idle = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert idle == []


@NETWORKS
def test_saved_model_reads_back_to_the_bit(config, tmp_path):
    model = operator(config, seed=3)
    save(tmp_path, model, config)
    inputs = tensors(samples())
    with torch.no_grad():
        assert torch.equal(read(tmp_path, PLANT, table=config).module(PLANT)(*inputs), model(*inputs))
    manifest = json.loads((tmp_path / "model.json").read_text())
    assert manifest["config"] == config.map_paths(lambda path: Path(path).name).model_dump(mode="json")


def test_snapshot_has_its_own_weights(tmp_path):
    save(tmp_path, operator(SMALL[0], seed=1), SMALL[0])
    early = operator(SMALL[0], seed=2)
    early.weights().save(tmp_path / "snapshot-7.safetensors")
    inputs = tensors(samples())
    with torch.no_grad():
        assert torch.equal(read(tmp_path, PLANT, snapshot=7).module(PLANT)(*inputs), early(*inputs))
        assert not torch.equal(read(tmp_path, PLANT).module(PLANT)(*inputs), early(*inputs))


@NETWORKS
@torch.no_grad()
def test_in_double_precision_it_rests_at_the_plants_own_equilibrium(config, tmp_path):
    model = operator(config, seed=3)
    save(tmp_path, model, config)
    double = read(tmp_path, PLANT, precision=np.float64, table=config).module(PLANT)
    rest = torch.tensor(PLANT.equilibrium)[None], torch.tensor(PLANT.u_equilibrium).expand(1, 21, 1)
    P_hat = double(*rest, torch.tensor([1.3], dtype=torch.float64))
    assert torch.equal(P_hat, rest[0].expand(1, 21, 2))
    inputs = tensors(samples())
    torch.testing.assert_close(double(*(a.double() for a in inputs)).float(), model(*inputs), rtol=1e-4, atol=1e-5)


def test_missing_snapshot_names_the_file_and_what_is_there(tmp_path):
    save(tmp_path, operator(SMALL[0]), SMALL[0])
    with pytest.raises(StoreError, match=r"snapshot-9\.safetensors: expected .*; files there: model\.safetensors$"):
        read(tmp_path, PLANT, snapshot=9)


def test_weights_of_another_network_are_refused_in_one_line(tmp_path):
    save(tmp_path, operator(SMALL[0]), SMALL[0])
    operator(SMALL[1]).weights().save(tmp_path / "model.safetensors")
    with pytest.raises(StoreError, match=r"^[^\n]*model\.safetensors: expected weights of this model[^\n]*$"):
        read(tmp_path, PLANT)


def test_broken_files_are_refused(tmp_path):
    with pytest.raises(StoreError, match=r"model\.json: expected a network"):
        read(tmp_path, PLANT)
    save(tmp_path, operator(SMALL[0]), SMALL[0])
    weights = tmp_path / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-20])
    with pytest.raises(StoreError, match=r"model\.safetensors: expected weights"):
        read(tmp_path, PLANT)


def test_equilibrium_anchor_needs_an_equilibrium():
    class Tracking:
        name, n, m, rest, phased = "tracking", 2, 1, None, False

    scaling = Scaling(2, 1)
    with pytest.raises(ConfigError, match="anchor: expected a plant with a rest, tracking has none"):
        build(DeepONet(), Tracking(), scaling)  # type: ignore[arg-type]
    build(DeepONet(anchor="initial"), Tracking(), scaling)  # type: ignore[arg-type]


def test_a_table_that_names_no_network_is_refused():
    with pytest.raises(ConfigError, match=r"network: expected deeponet, fno, .* got 'training'"):
        build(Training(), PLANT, Scaling(2, 1))


@NETWORKS
def test_inference_leaves_nothing_behind_that_training_cannot_use(config):
    model, inputs = operator(config), tensors(samples(3, nx=17))  # a grid of its own: nothing is cached for it yet
    with torch.inference_mode():
        model(*inputs)
    model(*inputs).sum().backward()
