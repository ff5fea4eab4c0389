"""The ONNX graph: equal to the model, any batch, folded, standard operators; and the predictor that runs it."""

import sys

import numpy as np
import pytest
import torch
from operator_samples import EVERY, PLANT, SMALL, operator, phased, samples

import npred
from npred import plants
from npred.base.errors import MissingError
from npred.base.registry import short_name
from npred.exports import NetworkAlone
from npred.exports import onnx as runtime
from npred.lab.training.neural import Neural
from npred.lab.training.operators import Scaling, build
from npred.loop import metrics

onnx = pytest.importorskip("onnx")


@pytest.fixture(scope="module")
def export(tmp_path_factory):
    """A function of a configuration: its model and its file for 21 nodes, written once."""
    made = {}

    def call(config):
        if config.architecture not in made:
            model, path = operator(config).eval(), tmp_path_factory.mktemp("onnx") / "model.onnx"
            data = samples(30, 21)
            network = NetworkAlone(model, PLANT, 21, (data.X, data.u, data.D_hat, np.zeros(30)))
            made[config.architecture] = model, path, runtime.export(network, path, atol=1e-3).facts["error"]
        return made[config.architecture]

    return call


@pytest.fixture(params=EVERY, ids=lambda config: short_name(config.architecture))
def exported(request, export):
    return export(request.param)


def test_control_is_kappa_of_the_end_of_P_for_any_batch(exported):
    model, path, error = exported
    assert error < 1e-3
    session = runtime.session(path.read_bytes())
    for batch in (1, 7):
        data = samples(batch, 21, seed=3)
        inputs = {name: getattr(data, name).astype(np.float32) for name in runtime.INPUTS}
        P, U = session.run(None, inputs)
        np.testing.assert_allclose(P, Neural(PLANT, model, 21)(data.X, data.u, data.D_hat), rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(U, PLANT.kappa(P[:, -1].astype(float)), rtol=1e-3, atol=1e-5)


def test_graph_is_standard_and_sound(exported):
    graph = onnx.load(exported[1])
    onnx.checker.check_model(graph, full_check=True)
    assert [(entry.domain, entry.version) for entry in graph.opset_import] == [("", runtime.OPSET)]
    assert {node.domain for node in graph.graph.node} == {""} and not graph.functions
    assert [i.name for i in graph.graph.input] == ["X", "u", "D_hat"]
    assert [o.name for o in graph.graph.output] == ["P", "U"]


def test_a_law_that_depends_on_time_takes_it(tmp_path):
    """The graph's U is the closed loop's: kappa at the time when U arrives."""
    plant, nx = plants.resolve("planar_arm2"), 11
    torch.manual_seed(0)
    model = build(SMALL[0].model_copy(update={"anchor": "initial"}), plant, Scaling(plant.n, plant.m)).eval()
    loop = npred.simulate(plant, Neural(plant, model, nx), D=0.3, D_hat=0.4, X0=[0.3, 0.6, 0.0, 0.0], t_end=1.0,
                          dt=0.05, samples=np.arange(20))  # fmt: skip
    probe = loop.samples.X, loop.samples.u, loop.samples.D_hat
    network = NetworkAlone(model, plant, nx, (*probe, loop.t[:20]))
    assert runtime.export(network, tmp_path / "arm.onnx", atol=1e-3).facts["error"] < 1e-3
    session = runtime.session((tmp_path / "arm.onnx").read_bytes())
    assert [i.name for i in session.get_inputs()] == ["X", "u", "D_hat", "t"]
    given = dict(zip(runtime.inputs(plant), (*probe, loop.t[:20]), strict=True))
    _, U = session.run(None, {name: a.astype(np.float32) for name, a in given.items()})
    np.testing.assert_allclose(U, loop.U[:20], rtol=1e-4, atol=1e-4)


def test_a_law_of_tables_and_pieces_is_in_the_graph():
    points, heights = [-3.0, -1.0, 0.0, 2.0], [0.0, 1.0, 3.0, 1.0]
    plant = plants.resolve("activator_repressor").controlled(
        lambda x, t, p, M: [
            M.interp(x[0], points, heights, "cubic") + M.interp(x[1], points, heights) + M.atan2(x[0], 1 + M.cosh(x[1]))
            + M.where(M.logical_and(x[0] < 1, M.logical_not(x[1] < 0)), M.floor(x[0]), M.mod(x[1], 2.0))
            + M.clip(M.sinh(x[0]), -1.0, 1.0)
        ]
    )  # fmt: skip
    torch.manual_seed(0)
    model = build(SMALL[0], plants.resolve("activator_repressor"), Scaling(plant.n, plant.m)).eval().float()
    X = np.random.default_rng(0).uniform(-2, 2, (9, 2)).astype(np.float32)
    feed = {"X": X, "u": np.zeros((9, 11, 1), np.float32), "D_hat": np.ones(9, np.float32)}
    P, U = runtime.session(runtime.graph(model, plant, 11)).run(["P", "U"], feed)
    np.testing.assert_allclose(U, plant.kappa(P[:, -1].astype(float)), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("config", SMALL, ids=lambda config: type(config).__name__)
def test_several_delays_and_a_phase_of_the_time(tmp_path, config):
    plant, data, t = phased()
    model = build(config, plant, Scaling.of(data)).eval()
    probe = data.X, data.u, data.D_hat
    network = NetworkAlone(model, plant, 13, (*probe, t))
    assert runtime.export(network, tmp_path / "m.onnx", atol=1e-3).facts["error"] < 1e-3
    session = runtime.session((tmp_path / "m.onnx").read_bytes())
    feed = dict(zip(["X", "u", "D_hat", "t"], (a.astype(np.float32) for a in (*probe, t)), strict=True))
    P, U = session.run(None, feed)
    np.testing.assert_allclose(P, Neural(plant, model.double(), 13)(*probe, t), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(U, metrics.law(plant, P.astype(float), t, data.D_hat), rtol=1e-2, atol=1e-3)


@pytest.mark.parametrize("exported", SMALL, indirect=True, ids=lambda config: config.architecture)
def test_trunk_and_transforms_are_constants(exported):
    """Activations are left for what depends on the sample: two rows of a branch, or of an FNO, and no trunk."""
    model, path, _ = exported
    kinds = [node.op_type for node in onnx.load(path).graph.node]
    branch = getattr(model.network, "branch", None)
    depth = len(branch) // 2 if branch else len(model.network.local) + 1
    assert kinds.count("Sigmoid") == 2 * depth
    assert not {"Sin", "Cos", "DFT", "Range"} & set(kinds)


def test_predicts_and_closes_the_loop():
    model, data = operator(SMALL[0]), samples(4, 31)
    run, wanted = runtime.Onnx(PLANT, model, 21), Neural(PLANT, model, 21)
    np.testing.assert_allclose(
        run(data.X, data.u, data.D_hat), wanted(data.X, data.u, data.D_hat), rtol=1e-5, atol=1e-5
    )
    loops = [
        npred.simulate(PLANT, r, D=1.0, D_hat=[0.8, 2.0], X0=[0.03, 30.0], t_end=0.5, dt=0.01) for r in (run, wanted)
    ]
    np.testing.assert_allclose(loops[0].X, loops[1].X, rtol=1e-4)


@pytest.mark.parametrize("package", ["onnx", "onnxscript", "onnxruntime"])
def test_a_missing_package_is_told(package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingError, match=rf"expected the package {package}, found none; pip install 'npred\[onnx\]'"):
        runtime.Onnx(PLANT, operator(SMALL[0]), 21)
