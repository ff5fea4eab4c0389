"""Policies as laws: twenty shapes in all ways to compute U, derivatives, observations, refusals, keys, pipelines."""

import math
import pickle
import re
import shutil
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from c_controllers import needs_gcc

import npred
from npred import plants
from npred.base.errors import ConfigError, MissingError
from npred.lab import config
from npred.lab.scheduler.configuration import identity
from npred.plants import Plant

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnx.reference")
pytest.importorskip("onnxruntime")
pytest.importorskip("torch")

import policies  # noqa: E402  # which needs them

PLANT = """
class Pendulum:
    states, inputs = ("angle", "rate"), ("torque",)
    parameters = {"goal": 0.1}
    box = {"angle": (-1.0, 1.0), "rate": (-1.0, 1.0)}

    def f(x, u, t, p, M):
        return [x.rate, M.sin(x.angle) - 0.2 * x.rate + u.torque]

    def kappa(x, t, p, M):
        return [-3.0 * x.angle - x.rate]

    def V(x, t, p, M):
        return x.angle**2 + x.rate**2

    def observation(x, u, t, p, M):
        return [M.cos(x.angle), M.sin(x.angle), x.rate, p.goal, 1.0, M.tanh(x.rate)]
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return policies.every(tmp_path_factory.mktemp("policies"))


@pytest.fixture
def jax(files):
    return next(file for file in files if file.name == "jax.onnx")


@pytest.fixture
def pendulum(tmp_path):
    path = tmp_path / "my_pendulum.py"
    path.write_text(PLANT)
    return f"{path}:Pendulum"


@pytest.fixture(scope="module")
def all_of_them(files) -> Plant:
    return policies.in_one_law(files)


X = policies.X


@pytest.fixture(scope="module")
def U(files):
    return policies.referees(files)


def near(computed, U, exact=1e-12):
    """It is onnxruntime's to 1e-6, and, in double, the reference's."""
    assert np.abs(computed - U[0]).max() < 1e-6
    assert np.abs(computed - U[1]).max() < exact


def test_there_are_twenty_of_three_exporters(files):
    assert len(files) == len({file.name for file in files}) == 20


def test_python_and_torch_compute_what_onnxruntime_does(all_of_them, U):
    near(all_of_them.kappa(X), U)
    assert all_of_them.kappa(X[0]).shape == (all_of_them.m,)
    import torch

    assert np.abs(all_of_them.kappa(torch.as_tensor(X)).numpy() - U[1]).max() < 1e-12


@pytest.mark.slow
@needs_gcc
def test_kernels_controllers_and_c_compute_the_same(all_of_them, U, tmp_path):
    """In float the C rounds as onnxruntime does, in another order."""
    computed = policies.routes(all_of_them, tmp_path)
    in_float = computed.pop("C, float")
    for route in computed.values():
        near(route, U)
    assert np.abs(in_float - U[1]).max() < 3e-6


def test_derivatives_are_those_of_differences(all_of_them):
    J, h = all_of_them.kappa_jacobian(X), 1e-6
    apart = [(all_of_them.kappa(X + h * e) - all_of_them.kappa(X - h * e)) / (2 * h) for e in np.eye(policies.SEEN)]
    np.testing.assert_allclose(J, np.stack(apart, -1), atol=1e-7)


@pytest.mark.parametrize(("op", "slope"), [("Relu", 0.0), ("LeakyRelu", 0.25), ("Elu", 0.25), ("Softplus", 0.5)])
def test_a_kink_has_the_derivative_of_pytorch(tmp_path, op, slope):
    rest = {"alpha": 0.25} if slope == 0.25 else {}
    file = policies.graph([(op, "obs", "mu", rest)], {}, tmp_path / "kink.onnx", (1, 1), (1, 1))
    plant = npred.plant(type("One", (policies.Still,), {"states": ("x",)}), kappa=str(file))
    J = plant.kappa_jacobian(np.array([[0.0], [900.0], [-900.0]]))
    assert J[0] == slope and J[1] == 1 and np.isfinite(J).all()


@pytest.fixture
def both(pendulum, tmp_path):
    """The pendulum with a small policy in its law, and with the same formulas."""
    draws = np.random.default_rng(3)
    W, V = draws.normal(size=(6, 4)).astype(np.float32), draws.normal(size=(4, 1)).astype(np.float32)
    nodes = [("MatMul", "obs W", "h", {}), ("Tanh", "h", "a", {}), ("MatMul", "a V", "mu", {})]
    law = npred.policy(policies.graph(nodes, {"W": W, "V": V}, tmp_path / "small.onnx", out=(1, 1)))

    def sees(x, p, M):
        return [M.cos(x.angle), M.sin(x.angle), x.rate, p.goal, 1.0, M.tanh(x.rate)]

    def called(x, t, p, M):
        return [0.2 * law(sees(x, p, M), t, p, M)[0] - x.rate]

    def written(x, t, p, M):
        seen = sees(x, p, M)
        hidden = [M.tanh(sum(a * k for a, k in zip(seen, row, strict=True))) for row in W.T.tolist()]
        return [0.2 * sum(a * k for a, k in zip(hidden, V[:, 0].tolist(), strict=True)) - x.rate]

    return npred.plant(pendulum, kappa=called), npred.plant(pendulum, kappa=written)


def test_a_loop_is_that_of_the_same_formulas(both):
    """Also the delay law, which takes the derivative along the prediction, and the search for rest."""
    assert np.abs(both[0].equilibrium - both[1].equilibrium).max() < 1e-12
    loops = [
        npred.simulate(
            plant, npred.predictor(plant, "heun", 21), D=0.2, D_hat=[0.1, 0.3], X0=[[0.5, 0.0], [-0.4, 0.3]], t_end=1.0,
            dt=0.02, adaptation=npred.DelayAdaptation(gamma=1.0, bounds=(0.05, 0.5)),
        )
        for plant in both
    ]  # fmt: skip
    for name in ("X", "U", "D_hat"):
        np.testing.assert_allclose(getattr(loops[0], name), getattr(loops[1], name), atol=1e-9)


def test_a_group_of_lanes_computes_what_one_does(jax):
    """With a delay per input the law is in the prediction, whose lanes go side by side."""
    law = npred.policy(jax)
    parts = {"inputs": ("a", "b"), "delays": (0.5, 1.0), "f": lambda x, u, t, p, M: [u.a - a for a in x]}
    plant = npred.plant(type("Two", (policies.Still,), parts), kappa=law)
    predict = npred.predictor(plant, "rk4", 5)
    u, D_hat = np.zeros((19, 5, 2)), np.linspace(0.2, 1.0, 19)
    P = predict.predict(X, u, D_hat, 0.0)
    alone = [predict.predict(X[k : k + 1], u[:1], D_hat[k : k + 1], 0.0)[0] for k in range(19)]
    np.testing.assert_allclose(P, alone, rtol=1e-12, atol=1e-14)
    assert np.ptp(P[:, -1] - X) > 0.1


def test_a_chunk_gives_the_row_that_is_asked_for(files):
    file = next(file for file in files if file.name.startswith("chunk"))
    rows = [npred.policy(file, row=k).network(*X[0]) for k in (0, 1)]
    (whole,) = (
        __import__("npred.exports.onnx", fromlist=["session"])
        .session(file.read_bytes())
        .run(None, {"obs": X[:1].astype(np.float32)})
    )
    np.testing.assert_allclose(rows, whole[0], atol=1e-6)
    with pytest.raises(ConfigError, match="row expected 0 to 1, got 2"):
        npred.policy(file, row=2)


def test_a_plant_says_what_its_policy_sees(files, pendulum):
    file = next(file for file in files if file.name.startswith("silu"))
    plant = npred.plant(pendulum, kappa={"law": "policy", "path": str(file), "scale": 2.0})
    angle, rate = X[:, 0], X[:, 1]
    seen = np.cos(angle), np.sin(angle), rate, 0.1, 1.0, np.tanh(rate)
    np.testing.assert_allclose(plant.kappa(X[:, :2])[:, 0], 2.0 * npred.policy(file).network(*seen)[0], rtol=1e-12)


def test_the_last_action_is_refused_by_name(files, tmp_path, pendulum):
    path = Path(pendulum.partition(":")[0])
    path.write_text(path.read_text().replace("p.goal, 1.0", "u.torque, 1.0"))
    file = next(file for file in files if file.name.startswith("silu"))
    plant = npred.plant(pendulum, kappa=str(file))
    with pytest.raises(
        ConfigError, match=r"observation .*expected what the state tells, got the last action, u; declare"
    ):
        plant.kappa(np.zeros(2))


def refused(nodes, tmp_path, **options):
    with pytest.raises(ConfigError) as error:
        npred.policy(policies.graph(nodes, {"W": np.eye(policies.SEEN)}, tmp_path / "other.onnx", **options))
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("op", "read", "rest"),
    [
        ("Softmax", "obs", {}), ("Erf", "obs", {}), ("MatMul", "obs obs", {}), ("Cast", "obs", {"to": 7}),
        ("RandomNormalLike", "obs", {}), ("ArgMax", "obs", {}), ("GatherElements", "obs obs", {}),
    ],
)  # fmt: skip
def test_other_operations_are_refused_by_their_names(tmp_path, op, read, rest):
    shape = (policies.SEEN, policies.SEEN) if op == "MatMul" else (1, policies.SEEN)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(onnx.checker, "check_model", lambda model: None)
        said = refused([(op, read, "mu", rest)], tmp_path, shape=shape)
    assert f"got {op} (node {op}_mu)" in said


@pytest.mark.parametrize(
    ("opset", "nodes"),
    [
        (13, [("Unsqueeze", "obs last", "o", {}), ("MatMul", "W o", "h", {}), ("Squeeze", "h last", "mu", {})]),
        (18, [("ReduceSum", "obs", "mu", {"noop_with_empty_axes": 1})]),
        (18, [("ReduceSum", "obs none", "mu", {})]),
        (18, [("ReduceMean", "obs one", "mu", {"keepdims": 0})]),
        (18, [("Gemm", "obs W ", "mu", {})]),
        (18, [("Concat", "obs empty", "mu", {"axis": 1})]),
    ],
)
def test_odd_graphs_give_what_the_reference_gives(tmp_path, opset, nodes):
    numbers = {"last": [2], "one": [1], "none": []}
    weights = {"W": np.arange(36.0).reshape(6, 6)} | {k: np.array(v, dtype=np.int64) for k, v in numbers.items()}
    weights |= {"empty": np.zeros((1, 0))}
    used = {name: a for name, a in weights.items() if any(name in read.split() for _, read, _, _ in nodes)}
    file = policies.graph(nodes, used, tmp_path / "odd.onnx", opset=opset)
    x = np.linspace(-1.0, 1.0, 6, dtype=np.float32)
    (wanted,) = onnx.reference.ReferenceEvaluator(onnx.load(file)).run(None, {"obs": x[None]})
    np.testing.assert_allclose(np.ravel(npred.policy(file).network(*x.astype(float))), np.ravel(wanted), rtol=1e-5)


@pytest.mark.parametrize(
    ("nodes", "said"),
    [
        ([("Cast", "obs", "h", {"to": 10}), ("Cast", "h", "mu", {"to": 1})], "got Cast"),
        ([("MatMul", "obs three", "mu", {})], "got MatMul"),
        ([("Add", "obs nan", "mu", {})], "expected finite weights"),
        ([("LayerNormalization", "obs ones", "h m", {}), ("Add", "h m", "mu", {})], "got LayerNormalization"),
    ],
)
def test_graphs_that_would_give_other_numbers_are_refused(tmp_path, nodes, said):
    weights = {"three": np.ones((1, 6, 6)), "nan": np.full(6, np.nan), "ones": np.ones(6)}
    used = {name: a for name, a in weights.items() if any(name in read.split() for _, read, _, _ in nodes)}
    with pytest.raises(ConfigError, match=said):
        npred.policy(policies.graph(nodes, used, tmp_path / "odd.onnx", opset=17))


def test_an_input_of_unknown_size_and_settings_that_are_none_are_refused(jax, tmp_path):
    open_ends = policies.graph([("Tanh", "obs", "mu", {})], {}, tmp_path / "open.onnx", shape=("b", "f"))
    for options, said in (
        ({"path": open_ends}, "got float of shape [0, 0], 0 for what is open"),
        ({"path": jax, "row": 0.5}, "row expected 0 to"), ({"path": jax, "scale": "x"}, "scale: expected a number"),
        ({"path": jax, "scale": math.nan}, "scale expected a number"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=re.escape(said)):
            npred.policy(**options)


def test_what_does_not_depend_on_the_state_is_refused(tmp_path):
    assert "expected one input, what it sees, got none" in refused([("Tanh", "W", "mu", {})], tmp_path)


def test_files_that_are_none_are_refused_in_one_line(jax, tmp_path):
    with pytest.raises(ConfigError, match="expected a file, got"):
        npred.policy(tmp_path / "absent.onnx")
    content = jax.read_bytes()
    for k, wrong in enumerate((b"", b"no graph", content[:-40], content[: len(content) // 2])):
        (tmp_path / "wrong.onnx").write_bytes(wrong)
        with pytest.raises(
            ConfigError, match=r"policy .*wrong\.onnx: expected an ONNX graph, got: .*; export it again"
        ) as said:
            npred.policy(tmp_path / "wrong.onnx")
        assert "\n" not in str(said.value), k
    with pytest.raises(ConfigError, match="output: expected one of mu, got 'value'"):
        npred.policy(jax, output="value")


def test_weights_that_are_not_finite_are_refused(jax, tmp_path):
    model = onnx.load(jax)
    weights = onnx.numpy_helper.to_array(model.graph.initializer[0]).copy()
    weights[0, 0] = math.nan
    model.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(weights, model.graph.initializer[0].name))
    onnx.save(model, str(tmp_path / "nan.onnx"))
    with pytest.raises(ConfigError, match="expected finite weights"):
        npred.policy(tmp_path / "nan.onnx")


def test_without_the_package_the_extra_is_named(jax, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(
        MissingError, match=r"policy: expected the package onnx, found none; pip install 'npred\[onnx\]'"
    ):
        npred.policy(jax)


def test_a_policy_that_sees_other_numbers_is_refused(files, pendulum):
    file = next(file for file in files if file.name == "td3.onnx")
    with pytest.raises(ConfigError, match=r"policy td3.onnx: expected to see 5 numbers, got 6; declare observation"):
        npred.plant(pendulum, kappa=str(file)).kappa(np.zeros(2))


def test_keys_follow_the_weights_and_not_the_path(files, pendulum, tmp_path):
    file = next(file for file in files if file.name.startswith("silu"))
    (tmp_path / "elsewhere").mkdir()
    moved = shutil.copy(file, tmp_path / "elsewhere" / "other.onnx")
    first, same = (plants.resolve(pendulum, kappa=str(path)) for path in (file, moved))
    assert identity(first) == identity(same)
    model = onnx.load(file)
    weights = onnx.numpy_helper.to_array(model.graph.initializer[0]).copy()
    weights.flat[0] += 1e-3
    model.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(weights, model.graph.initializer[0].name))
    onnx.save(model, str(moved))
    other = plants.resolve(pendulum, kappa=str(moved))
    assert identity(first)["program"]["kappa"] != identity(other)["program"]["kappa"]
    assert identity(first)["program"]["f"] == identity(other)["program"]["f"]


def test_a_plant_is_pickled_with_its_policy(files, pendulum):
    file = next(file for file in files if file.name.startswith("silu"))
    plant = npred.plant(pendulum, kappa=str(file))
    again, other = (pickle.loads(pickle.dumps(plant)) for _ in range(2))
    assert again is other
    np.testing.assert_array_equal(again.kappa(X[:, :2]), plant.kappa(X[:, :2]))


def test_a_pipeline_names_a_policy_beside_itself(files, pendulum, tmp_path):
    file = next(file for file in files if file.name.startswith("silu"))
    shutil.copy(file, tmp_path / "policy.onnx")
    (tmp_path / "mine.toml").write_text('plant = "my_pendulum.py:Pendulum"\nkappa = "policy.onnx"\n')
    pipeline = config.load(tmp_path / "mine.toml")
    assert pipeline.kappa == str(tmp_path / "policy.onnx")
    assert sorted(pipeline.files) == ["my_pendulum.py", "policy.onnx"]
    assert plants.resolve(*pipeline.of_plant).law.file == "policy.onnx"
    table = tomllib.loads('kappa = {law = "policy", path = "policy.onnx", scale = 2.0}')
    (tmp_path / "mine.toml").write_text(
        'plant = "my_pendulum.py:Pendulum"\nkappa = {law = "policy", path = "policy.onnx", scale = 2.0}\n'
    )
    pipeline = config.load(tmp_path / "mine.toml")
    assert pipeline.kappa == table["kappa"] | {"path": str(tmp_path / "policy.onnx")}
    assert plants.resolve(*pipeline.of_plant).law.scale == 2.0
