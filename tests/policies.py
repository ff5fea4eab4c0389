"""Policies of twenty shapes, as PyTorch, Stable-Baselines3 and graphs in the style of JAX and rl_games have them."""

import warnings

import numpy as np
import onnx
import torch
from c_controllers import InC, library
from onnx import TensorProto, helper, numpy_helper
from torch import nn

import npred
from npred.exports.onnx import session
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4

SEEN = 6  # the most numbers that one of them sees
X = np.random.default_rng(0).uniform(-1.5, 1.5, (19, SEEN)).astype(np.float32).astype(float)


class Still:
    """A plant that does not move: the state predicted for it is the state, and U is kappa of that."""

    states = tuple(f"x{k}" for k in range(SEEN))
    inputs = ("u",)

    def f(x, u, t, p, M):
        return [0.0] * len(x)

    def kappa(x, t, p, M):
        return [0.0]


class LastTwo(nn.Module):
    """Gathers, slices and joins what it sees, and gives a chunk of two actions."""

    def __init__(self):
        super().__init__()
        self.actor = mlp([7, 32, 4], nn.ELU)

    def forward(self, x):
        x = torch.cat([x[:, [4, 0]], x[:, 1:5], torch.ones_like(x[:, :1])], -1)
        return self.actor(x).reshape(-1, 2, 2)


class Scripted(nn.Module):
    def __init__(self, actor):
        super().__init__()
        self.actor = actor

    def forward(self, x):
        return torch.tanh(torch.clamp(self.actor(x), -2.0, 2.0))


def mlp(sizes, activation, norm=False):
    layers = []
    for k, (a, b) in enumerate(zip(sizes, sizes[1:], strict=False)):
        layers += [nn.Linear(a, b)]
        if k < len(sizes) - 2:
            layers += [nn.LayerNorm(b)] * norm + [activation()]
    return nn.Sequential(*layers)


TORCH = {
    "linear": lambda: mlp([4, 2], nn.Tanh),
    "one": lambda: mlp([1, 1, 1], nn.Sigmoid),
    "tanh": lambda: mlp([6, 64, 64, 2], nn.Tanh),
    "relu": lambda: mlp([3, 256, 1], nn.ReLU),
    "elu_norm": lambda: mlp([5, 256, 256, 2], nn.ELU, norm=True),
    "leaky": lambda: mlp([6, 32, 17, 9, 1], lambda: nn.LeakyReLU(0.2)),
    "softplus": lambda: mlp([2, 128, 3], nn.Softplus),
    "silu": lambda: Scripted(mlp([6, 48, 48, 1], nn.SiLU)),
    "shrink": lambda: mlp([4, 24, 2], nn.Tanhshrink),
    "chunk": LastTwo,
}
DYNAMO = ("tanh", "chunk")  # of them, those that the newer exporter writes too


def of_torch(name, folder, dynamo=False):
    torch.manual_seed(sum(map(ord, name)))
    actor = TORCH[name]().eval()
    seen = next(layer.in_features for layer in actor.modules() if isinstance(layer, nn.Linear))
    path = folder / f"{name}{'_dynamo' * dynamo}.onnx"
    return exported(actor, min(seen, SEEN) if name != "chunk" else SEEN, path, dynamo)


def exported(actor, seen, path, dynamo=False):
    shapes = (
        {"dynamic_shapes": ({0: torch.export.Dim("batch")},)} if dynamo else {"dynamic_axes": {"obs": {0: "batch"}}}
    )
    options = {"input_names": ["obs"], "dynamo": dynamo, "verbose": False, "external_data": False} | shapes
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(actor, (torch.zeros(2, seen),), str(path), **options)
    return path


class OnnxableSB3Policy(nn.Module):
    """As Stable-Baselines3's documentation exports a policy: all of its results."""

    def __init__(self, policy, mean, spread):
        super().__init__()
        self.policy, self.mean, self.spread = policy, torch.as_tensor(mean), torch.as_tensor(spread)

    def forward(self, x):
        from stable_baselines3.td3.policies import Actor

        x = torch.clip((x - self.mean) / self.spread, -10.0, 10.0)  # VecNormalize
        return self.policy(x) if isinstance(self.policy, Actor) else self.policy(x, deterministic=True)


def of_sb3(folder):
    from gymnasium.spaces import Box
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.sac.policies import SACPolicy
    from stable_baselines3.td3.policies import TD3Policy

    torch.manual_seed(5)
    draws = np.random.default_rng(5)
    kinds = {
        "ppo": (ActorCriticPolicy, {}),
        "ppo_relu": (ActorCriticPolicy, {"net_arch": [32], "activation_fn": nn.ReLU}),
        "sac": (SACPolicy, {"net_arch": [64, 64]}),
        "td3": (TD3Policy, {"net_arch": [40, 30]}),
    }
    for name, (kind, options) in kinds.items():
        spaces = Box(-np.inf, np.inf, (5,), np.float32), Box(-1.0, 1.0, (2,), np.float32)
        policy = kind(*spaces, lambda _: 1e-3, **options).eval()
        policy = policy if kind is ActorCriticPolicy else policy.actor  # whose mean is squashed
        mean, spread = draws.uniform(-0.3, 0.3, 5), draws.uniform(0.5, 2.0, 5)
        yield exported(
            OnnxableSB3Policy(policy, mean.astype(np.float32), spread.astype(np.float32)), 5, folder / f"{name}.onnx"
        )


def graph(nodes, weights, path, shape=(1, SEEN), out=(1, 2), opset=13, ir=8):
    """A graph of nodes (op, inputs, output, attributes) and weights by name, written to a file."""
    made = [helper.make_node(op, read.split(" "), y.split(), name=f"{op}_{y}", **rest) for op, read, y, rest in nodes]
    ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in (("obs", shape), ("mu", out))]
    tensors = [
        numpy_helper.from_array(a if a.dtype == np.int64 else a.astype(np.float32), name) for name, a in weights.items()
    ]
    whole = helper.make_graph(made, "policy", ends[:1], ends[1:], tensors)
    onnx.save(helper.make_model(whole, opset_imports=[helper.make_opsetid("", opset)], ir_version=ir), str(path))
    return path


def by_hand(folder):
    draws = np.random.default_rng(7)
    n = SEEN
    w = {
        "W": draws.normal(size=(n, 40)) / 2,
        "b": draws.normal(size=40),
        "V": draws.normal(size=(40, 2)) / 6,
        "c": draws.normal(size=2),
    }
    dense = [("MatMul", "obs W", "h", {}), ("Add", "h b", "g", {}), ("Tanh", "g", "a", {}), ("MatMul", "a V", "y", {})]
    yield graph([*dense, ("Add", "y c", "mu", {})], w, folder / "jax.onnx", ("batch", n), ("batch", 2))
    flat = {"W": w["W"].T, "V": w["V"].T, "b": w["b"], "c": w["c"]}
    nodes = [
        ("MatMul", "W obs", "h", {}),
        ("Add", "h b", "g", {}),
        ("Relu", "g", "a", {}),
        ("MatMul", "V a", "y", {}),
        ("Add", "c y", "mu", {}),
    ]
    yield graph(nodes, flat, folder / "jax_vector.onnx", (n,), (2,))
    running = w | {
        "mean": draws.normal(size=n),
        "std": draws.uniform(0.5, 2, n),
        "low": np.array(-1.0),
        "high": np.array(1.0),
    }
    nodes = [
        ("Sub", "obs mean", "o1", {}),
        ("Div", "o1 std", "o2", {}),
        ("Clip", "o2 low high", "o", {}),
        ("Cast", "o", "o3", {"to": 1}),
        *((op, read.replace("obs", "o3"), y, rest) for op, read, y, rest in dense),
        ("Add", "y c", "mu", {}),
    ]
    yield graph(nodes, running, folder / "rl_games.onnx")
    norm = w | {
        "two": np.array(2.0),
        "eps": np.array(1e-5),
        "gain": draws.normal(size=40),
        "shift": draws.normal(size=40),
    }
    nodes = [
        ("MatMul", "obs W", "h", {}),
        ("ReduceMean", "h", "m", {"axes": [-1]}),
        ("Sub", "h m", "d", {}),
        ("Pow", "d two", "q", {}),
        ("ReduceMean", "q", "v", {"axes": [-1]}),
        ("Add", "v eps", "e", {}),
        ("Sqrt", "e", "s", {}),
        ("Div", "d s", "z", {}),
        ("Mul", "z gain", "z1", {}),
        ("Add", "z1 shift", "z2", {}),
        ("Elu", "z2", "a", {"alpha": 0.7}),
        ("MatMul", "a V", "mu", {}),
    ]
    yield graph(nodes, norm, folder / "norm.onnx")
    parts = w | {
        "one": np.array([1]),
        "five": np.array([5]),
        "axis": np.array([1]),
        "some": np.array([5, 0]),
        "shape": np.array([0, -1]),
    }
    nodes = [
        ("Slice", "obs one five axis", "p", {}),
        ("Gather", "obs some", "r", {"axis": 1}),
        ("Concat", "p r", "o", {"axis": 1}),
        ("Unsqueeze", "o axis", "o1", {}),
        ("Squeeze", "o1 axis", "o2", {}),
        ("Reshape", "o2 shape", "o3", {}),
        ("Identity", "o3", "o4", {}),
        ("Gemm", "o4 W b", "h", {"alpha": 0.5, "beta": 2.0}),
        ("Sigmoid", "h", "a", {}),
        ("Flatten", "a", "a1", {}),
        ("MatMul", "a1 V", "y", {}),
        ("Tanh", "y", "mu", {}),
    ]
    yield graph(nodes, parts, folder / "parts.onnx")
    nodes = [
        ("Gemm", "obs W b", "h", {"transB": 1}),
        ("Clip", "h", "a", {"min": -0.5, "max": 2.0}),
        ("Softplus", "a", "s", {}),
        ("LeakyRelu", "s", "l", {}),
        ("MatMul", "l V", "y", {}),
        ("Transpose", "y", "t", {"perm": [1, 0]}),
        ("Transpose", "t", "u", {}),
        ("Neg", "u", "mu", {}),
    ]
    yield graph(nodes, w | {"W": w["W"].T}, folder / "old.onnx", opset=9, ir=4)


def in_double(model):
    """The model in double precision, for the reference of ONNX: onnxruntime rounds to 1e-7."""
    floats = [t for t in model.graph.initializer if t.data_type == TensorProto.FLOAT]
    constants = [a.t for node in model.graph.node for a in node.attribute if a.t.data_type == TensorProto.FLOAT]
    for tensor in [*floats, *constants]:
        tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor).astype(float), tensor.name))
    for value in [*model.graph.input, *model.graph.output]:
        value.type.tensor_type.elem_type = TensorProto.DOUBLE
    for a in (a for node in model.graph.node if node.op_type == "Cast" for a in node.attribute):
        a.i = TensorProto.DOUBLE
    for a in (a for node in model.graph.node if node.op_type == "LayerNormalization" for a in node.attribute):
        a.i = TensorProto.DOUBLE if a.name == "stash_type" else a.i
    return model


def every(folder):
    """The files of all twenty."""
    files = [of_torch(name, folder) for name in TORCH if name not in DYNAMO]
    files += [of_torch(name, folder, dynamo=True) for name in DYNAMO]
    return [*files, *of_sb3(folder), *by_hand(folder)]


def in_one_law(files):
    """A plant with an input for each action of each policy: one kernel has all networks."""
    laws = [npred.policy(file) for file in files]
    count = sum(law.network.size for law in laws)

    def kappa(x, t, p, M):
        return [a for law in laws for a in law(x[: law.network.count], t, p, M)]

    return npred.plant(type("Still", (Still,), {"inputs": tuple(f"u{k}" for k in range(count))}), kappa=kappa)


def referees(files):
    """U (rows of X, inputs) by onnxruntime, which computes in float, and by ONNX's reference in double."""
    from onnx.reference import ReferenceEvaluator

    columns = [[], []]
    for file in files:
        model = onnx.load(file)
        shape, name = [d.dim_value for d in model.graph.input[0].type.tensor_type.shape.dim], model.graph.input[0].name
        run = session(model.SerializeToString()), ReferenceEvaluator(in_double(model))
        for of, evaluator, kind in zip(columns, run, (np.float32, float), strict=True):
            seen = X[:, : shape[-1]].astype(kind)
            rows = [evaluator.run(None, {name: x if len(shape) == 1 else x[None]})[0] for x in seen]
            of.append([row.reshape(-1, row.shape[-1])[0] for row in rows])  # of a chunk the first
    return tuple(np.hstack(of) for of in columns)


def routes(plant, folder):
    """U by each way to compute it."""
    lanes, U = len(X), np.empty((plant.m, len(X)))
    P = np.repeat(X.T[None], 2, axis=0)
    problem_of(plant).control(RK4.step)(P, np.zeros((2, plant.m, lanes)), np.ones(lanes), 0.0, np.zeros(1), U)
    of = npred.controller(plant, npred.predictor(plant, "euler", 2), None, 0.1, D_hat=0.1)
    computed = {"Python": plant.kappa(X), "lanes": U.T, "controller": np.array([of.step(x).copy() for x in X])}
    for precision in ("double", "float"):
        (folder / precision).mkdir()
        in_c = InC(library(of, folder / precision, precision), plant, precision)
        computed[f"C, {precision}"] = np.array([in_c.step(x).copy() for x in X])
    return computed
