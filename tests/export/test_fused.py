"""The fused function equals the torch model: both networks, all anchors, any grid, any number of lanes, in the loop."""

import copy
import subprocess
import sys

import numpy as np
import pytest
import torch
from conftest import process_environment
from operator_samples import PLANT, SMALL, holding, operator, phased, samples, several_inputs

import npred
from npred.base.errors import ConfigError
from npred.lab.config import FNO, DeepONet
from npred.lab.training.neural import Neural
from npred.lab.training.operators import Scaling, build
from npred.networks.fused import Fused, coarsest, fold

ANCHORS = ("none", "initial", "equilibrium")


def pair(config, nx, **changes):
    """The same operator fused and in torch."""
    model = operator(config, **changes)
    return Fused(PLANT, model, nx), Neural(PLANT, copy.deepcopy(model), nx)


@pytest.mark.parametrize("anchor", ANCHORS)
@pytest.mark.parametrize("config", SMALL, ids=lambda config: type(config).__name__)
def test_equals_the_torch_model(config, anchor):
    fused, torch_model = pair(config, 21, anchor=anchor)
    data = samples(9, 21)
    found, wanted = (run(data.X, data.u, data.D_hat) for run in (fused, torch_model))
    assert (np.abs(found - wanted).max(axis=(0, 1)) < 1e-5 * np.abs(wanted).max(axis=(0, 1))).all()


@pytest.mark.parametrize("config", SMALL, ids=lambda config: type(config).__name__)
def test_equals_the_torch_model_in_double_precision(config):
    """Also where rest is near: the anchor is exact."""
    model = operator(config).double()
    model.X_rest.copy_(torch.tensor(PLANT.equilibrium))
    model.u_rest.copy_(torch.tensor(PLANT.u_equilibrium))
    fused = Fused(PLANT, copy.deepcopy(model), 21, precision=np.float64)
    data = samples(9, 21)
    X = np.concatenate([data.X, [PLANT.equilibrium * (1 + 1e-6)]])
    u = np.concatenate([data.u, np.full((1, 21, 1), PLANT.u_equilibrium)])
    D_hat = np.append(data.D_hat, 1.0)
    np.testing.assert_allclose(fused(X, u, D_hat), Neural(PLANT, model, 21)(X, u, D_hat), rtol=1e-11)


@pytest.mark.parametrize("factor", [5, 1000])
def test_weights_whose_activations_are_far_from_zero(factor):
    """Where differences from rest are of order 1, and where exp(-x) overflows."""
    model, data = operator(SMALL[0]).double(), samples(9, 21)
    model.X_rest.copy_(torch.tensor(PLANT.equilibrium))
    model.u_rest.copy_(torch.tensor(PLANT.u_equilibrium))
    with torch.no_grad():
        for weight in model.network.parameters():
            weight *= factor
    fused = Fused(PLANT, copy.deepcopy(model), 21, precision=np.float64)
    found, wanted = (run(data.X, data.u, data.D_hat) for run in (fused, Neural(PLANT, model, 21)))
    assert np.abs(found - wanted).max() < 1e-11 * np.abs(wanted).max()


@pytest.mark.parametrize("nx", [2, 24, 103])  # remainders by four: 2, 0, 3; elsewhere 1
def test_any_grid_in_a_call(nx):
    for config in SMALL:
        fused, torch_model = pair(config, 21)
        data = samples(3, nx)
        np.testing.assert_allclose(
            fused(data.X, data.u, data.D_hat), torch_model(data.X, data.u, data.D_hat), rtol=1e-5, atol=1e-5
        )


@pytest.mark.parametrize("nx", [256, 257, 1001])
@pytest.mark.parametrize("inputs", [1, 2])
def test_a_deeponet_on_a_fine_grid_is_exact_on_every_node(nx, inputs):
    """By the parity of its moments, and by a few functions on each piece of the grid."""
    plant, data = (PLANT, samples(4, 11)) if inputs == 1 else several_inputs()
    torch.manual_seed(0)
    model = build(SMALL[0], plant, Scaling.of(data))
    call = data.X, data.u[:, np.arange(nx) * 10 // (nx - 1)], data.D_hat
    wanted, fused = Neural(plant, copy.deepcopy(model).double(), nx)(*call), Fused(plant, model, nx)
    assert ("local" in fold(model, plant, nx).constants) == (nx == 1001)
    assert (np.abs(fused(*call) - wanted).max(axis=(0, 1)) < 2e-6 * np.abs(wanted).max(axis=(0, 1))).all()


def test_an_fno_on_a_fine_grid_is_exact_on_every_stride_th_node_and_near_between():
    model, data = operator(FNO(width=6, modes=4, layers=2)), samples(3, 203)
    assert (coarsest(101), coarsest(1001), coarsest(203)) == (1, 10, 2)
    fused, torch_model = Fused(PLANT, model, 203), Neural(PLANT, copy.deepcopy(model), 203)
    found, wanted = (run(data.X, data.u, data.D_hat) for run in (fused, torch_model))
    coarse = Neural(PLANT, copy.deepcopy(model), 102)(data.X, data.u[:, ::2], data.D_hat)
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found[:, ::2], coarse, rtol=2e-5, atol=2e-5)


def test_a_branch_of_one_hidden_layer():
    fused, torch_model = pair(DeepONet(width=12, depth=1, basis=5, trunk=8, moments=4), 21)
    data = samples(4, 21)
    np.testing.assert_allclose(
        fused(data.X, data.u, data.D_hat), torch_model(data.X, data.u, data.D_hat), rtol=1e-5, atol=1e-6
    )


@pytest.mark.parametrize(("D_hat", "spread"), [(0.01, None), (25.0, None), (0.1, 0.05)])
def test_delays_far_from_the_data(D_hat, spread):
    """An FNO's series at rest ends there, also below data of nearly one delay; beyond, rest is evaluated."""
    for config in SMALL:
        model = operator(config)
        if spread:
            model.scaling.D_hat_std.fill_(spread)
        fused, torch_model = Fused(PLANT, model, 21), Neural(PLANT, copy.deepcopy(model), 21)
        data = samples(3, 21)
        found, wanted = (run(data.X, data.u, D_hat) for run in (fused, torch_model))
        np.testing.assert_allclose(found, wanted, rtol=2e-5, atol=2e-5 * D_hat)


def test_rests_at_rest_to_the_bit():
    fused, _ = pair(SMALL[0], 31)
    u = np.full((4, 31, 1), PLANT.u_equilibrium)
    P = fused(PLANT.equilibrium, u, np.array([0.2, 0.9, 1.7, 3.0]))
    np.testing.assert_array_equal(P, np.broadcast_to(PLANT.equilibrium, P.shape))


@pytest.mark.parametrize("distance", [1e-2, 1e-5, 1e-8])
def test_error_is_relative_to_the_distance_from_rest(distance):
    """In float32, yet as close to rest as one likes: the network carries differences from rest."""
    model = operator(SMALL[0])
    exact = copy.deepcopy(model).double()
    exact.X_rest.copy_(torch.tensor(PLANT.equilibrium))
    exact.u_rest.copy_(torch.tensor(PLANT.u_equilibrium))
    X = PLANT.equilibrium * (1 + distance)
    u = (PLANT.u_equilibrium + distance * np.cos(3 * np.linspace(0, 1, 31)))[:, None]
    found, wanted = (run(X, u, 1.3) for run in (Fused(PLANT, model, 31), Neural(PLANT, exact, 31)))
    assert (np.abs(found - wanted).max(axis=0) < 1e-5 * np.abs(wanted - X).max(axis=0) + 1e-15).all()


def test_several_inputs():
    plant, data = several_inputs()
    for config in (DeepONet(width=12, depth=2, basis=5, trunk=8, moments=4), FNO(width=6, modes=3, layers=2)):
        torch.manual_seed(0)
        model = build(config, plant, Scaling.of(data))
        np.testing.assert_allclose(
            Fused(plant, model, 11)(data.X, data.u, data.D_hat),
            Neural(plant, model, 11)(data.X, data.u, data.D_hat),
            rtol=1e-5, atol=1e-5,
        )  # fmt: skip


@pytest.mark.parametrize("config", SMALL, ids=lambda config: type(config).__name__)
def test_a_plant_that_tracks_what_stands_still_has_a_point_of_rest(config):
    plant, data = holding()
    torch.manual_seed(0)
    model = build(config, plant, Scaling.of(data))
    fused, torch_model = Fused(plant, model, 11), Neural(plant, copy.deepcopy(model), 11)
    found, wanted = (run(data.X, data.u, data.D_hat) for run in (fused, torch_model))
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(fused([0.5], np.full((11, 1), 0.5), 1.3), np.full((11, 1), 0.5), rtol=1e-6)


@pytest.mark.parametrize("anchor", ANCHORS)
@pytest.mark.parametrize("config", SMALL, ids=lambda config: type(config).__name__)
def test_a_network_that_sees_the_time(config, anchor):
    plant, data, t = phased()
    torch.manual_seed(0)
    model = build(config.model_copy(update={"anchor": anchor}), plant, Scaling.of(data)).double()
    fused, torch_model = Fused(plant, model, 13, precision=np.float64), Neural(plant, copy.deepcopy(model), 13)
    P = torch_model(data.X, data.u, data.D_hat, t)
    np.testing.assert_allclose(fused(data.X, data.u, data.D_hat, t), P, rtol=1e-11, atol=1e-12)
    assert np.abs(torch_model(data.X, data.u, data.D_hat, t + 0.5) - P).max() > 1e-3  # it does see it
    if anchor == "equilibrium":
        rest = fused(np.zeros(3), np.zeros((13, 2)), 0.6, 1.7)
        np.testing.assert_array_equal(rest, np.zeros((13, 3)))


def test_lanes_give_what_single_calls_give():
    for config in SMALL:
        fused, _ = pair(config, 31)
        data = samples(5, 31)
        P = np.empty((31, 2, 5))
        inputs = (np.array(a, order="C") for a in (data.X.T, data.u.transpose(1, 2, 0), data.D_hat))
        fused.lanes()(*inputs, 0.0, PLANT.p, P)
        for k in range(5):
            np.testing.assert_array_equal(P[..., k], fused(data.X[k], data.u[k], data.D_hat[k]))


def test_closes_the_loop_in_the_compiled_engine():
    fused, torch_model = pair(SMALL[0], 31)
    law = npred.DelayAdaptation(1000.0, 1.0, (0.1, 4.0))
    found, wanted = (
        npred.simulate(PLANT, run, D=1.0, D_hat=[0.8, 2.0], X0=[0.03, 30.0], t_end=1.0, dt=0.01, adaptation=law)
        for run in (fused, torch_model)
    )
    np.testing.assert_allclose(found.X, wanted.X, rtol=1e-4)
    np.testing.assert_allclose(found.D_hat, wanted.D_hat, rtol=1e-4)


def test_nan_stays_visible():
    for config in SMALL:
        fused, _ = pair(config, 21)
        P = fused.predict(np.array([[np.nan, 1.0]]), np.zeros((1, 21, 1)), np.ones(1), 0.0)  # as a loop calls it
        assert np.isnan(P[0, -1]).all()


def test_a_network_without_a_program_is_told():
    model = operator(SMALL[0])
    model.network = torch.nn.Identity()
    with pytest.raises(
        ConfigError, match=r"fused: expected a network that can be lowered \(deeponet, fno\), got Identity"
    ):
        Fused(PLANT, model, 11).lanes()


FOLDED = """
import hashlib, numpy as np
from operator_samples import PLANT, operator
from npred.lab.config import FNO, DeepONet
from npred.networks.fused import Fused

for config in (DeepONet(), FNO()):
    kernel = Fused(PLANT, operator(config).double(), 51, precision=np.float64).on(51)
    print(hashlib.sha256(kernel.unit.encode()).hexdigest())
"""


def test_the_number_of_threads_changes_no_digit_of_a_folded_network():
    texts = []
    for count in ("1", "2"):
        threads = {"OMP_NUM_THREADS": count, "OPENBLAS_NUM_THREADS": count}
        done = subprocess.run(
            [sys.executable, "-c", FOLDED], env=process_environment(**threads), capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        texts.append(done.stdout)
    assert texts[0] == texts[1] and len(set(texts[0].split())) == 2
