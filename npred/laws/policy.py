"""A learned policy as the law: an ONNX graph, read into the matrices and formulas that kernels compile.

Each value of the graph is an array of constants, or one of slots of npred.formulas.network. What only moves numbers, as
Reshape and Slice, is done here on the arrays of slots, and costs nothing later.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from npred.base import array_checks, json_files
from npred.base.errors import ConfigError, first_line, required, unlisted
from npred.formulas import Parameters, Value
from npred.formulas.network import FORMULAS, Affine, CalledNetwork, Each, network
from npred.formulas.tape import Functions

if TYPE_CHECKING:
    from npred.plants.base import Plant

MOVES = (
    "Concat", "Expand", "Flatten", "Gather", "GatherND", "Reshape", "Slice", "Split", "Squeeze", "Transpose",
    "Unsqueeze",
)  # fmt: skip
DEFAULTS = {"LeakyRelu": {"alpha": 0.01}, "Elu": {"alpha": 1.0}, "Clip": {"min": -np.inf, "max": np.inf}}
RANDOM = ("RandomNormal", "RandomUniform", "Bernoulli", "Multinomial", "Dropout")


class Slots(NamedTuple):
    """A value that depends on what the policy sees: the slot of each of its numbers."""

    at: np.ndarray


@dataclass(frozen=True)
class Policy:
    """A policy as a law: U is a row of what its network gives, times `scale`.

    Its network sees the state, or what the plant's observation(x, u, t, p, M) gives.
    """

    network: CalledNetwork
    file: str
    scale: float | tuple[float, ...] = 1.0
    observes: ClassVar[bool] = True  # npred.formulas.declared.call

    def __call__(self, x: Sequence[Value], t: Value, p: Parameters, M: Functions) -> list[Value]:
        if len(x) != self.network.count:
            what = f"expected to see {self.network.count} numbers, got {len(x)}"
            raise ConfigError(f"policy {self.file}: {what}; declare observation(x, u, t, p, M), a list of them")
        U = self.network(*x)
        scales = self.scale if isinstance(self.scale, tuple) else [self.scale] * len(U)
        if len(scales) != len(U):
            raise ConfigError(f"policy {self.file}: expected {len(U)} numbers as scale, got {len(scales)}; give them")
        return [a if scale == 1 else scale * a for scale, a in zip(scales, U, strict=True)]

    def __str__(self) -> str:
        return f"kappa = npred.policy({self.file!r})"


def policy(path: str | Path, *, output: str = "", row: int = 0, scale: float | Sequence[float] = 1.0) -> Policy:
    """The policy of an ONNX file as a law: kappa of npred.plant.

    Parameters
    ----------
    path : str or Path
        The file, as PyTorch, Stable-Baselines3, rl_games or JAX export an actor: of one input, what the policy sees, to
        one action per input of the plant.
    output : str, optional
        The name of the output that has the actions, as "mu"; by default the first.
    row : int
        Of a chunk of actions (k, m): the one that is taken. The chunk is computed in each control step.
    scale : float or sequence of m, the inputs' units
        What the actions are multiplied with; a policy that was trained on actions in [-1, 1] has the inputs' bounds.

    Returns
    -------
    Policy
        A law that sees the states in their order, or what the plant's observation(x, u, t, p, M) gives.

    Raises
    ------
    ConfigError
        For a file that is missing or no ONNX, and for an operation that npred does not have, by its name.
    MissingError
        Without the onnx extra.
    """
    onnx, *_ = (required("policy", f"onnx{part}", "onnx", "onnx") for part in ("", ".inliner", ".reference"))
    file = Path(path).name
    try:
        model = onnx.load(json_files.regular(Path(path)))
        onnx.checker.check_model(model)
        model = onnx.inliner.inline_local_functions(model)
    except OSError as error:
        raise ConfigError(f"policy {path}: expected a file, got: {error.strerror or error}; check the path") from None
    except Exception as error:  # of protobuf and of the checker
        got = f"expected an ONNX graph, got: {first_line(error)}"
        raise ConfigError(f"policy {path}: {got}; export it again") from None
    reader = _Reader(onnx, model, file)
    actions = reader.output(output)
    rows = actions.reshape(-1, actions.shape[-1] if actions.ndim else 1)
    if not isinstance(row, int) or not 0 <= row < len(rows):
        raise ConfigError(f"policy {file}: row expected 0 to {len(rows) - 1}, got {row!r}; choose one of its actions")
    scales = array_checks.floats(f"policy {file}: scale", scale, what := "a number, or one per input").tolist()
    if not np.isfinite(scales).all():
        raise ConfigError(f"policy {file}: scale expected {what}, got {scale!r}; give numbers")
    scales = tuple(scales) if isinstance(scales, list) else scales
    return Policy(network(reader.count, reader.parts, rows[row]), file, scales)


def law(plant: "Plant", path: str, output: str = "", row: int = 0, scale: float | Sequence[float] = 1.0) -> Policy:
    """The law of kappa = {law = "policy", path = "policy.onnx"}; see `policy`."""
    return policy(path, output=output, row=row, scale=scale)


class _Reader:
    """The parts of a network from the nodes of a graph, by the names of their results."""

    def __init__(self, onnx: Any, model: Any, file: str) -> None:
        self.onnx, self.graph, self.opsets, self.file = onnx, model.graph, model.opset_import, file
        self.values: dict[str, Slots | np.ndarray] = {
            tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in model.graph.initializer
        }
        self.count, self.size, self.parts = 0, 0, list[Affine | Each]()
        self.floats = onnx.TensorProto.FLOAT, onnx.TensorProto.DOUBLE

    def output(self, name: str) -> np.ndarray:
        """The slots of an output, by default the first. Only what it depends on is read."""
        names = [value.name for value in self.graph.output]
        if not names or (name and name not in names):
            raise ConfigError(unlisted(f"policy {self.file}: output", name, names))
        needed, nodes = {name or names[0]}, []
        for node in reversed(self.graph.node):
            if needed & {*node.output}:
                nodes.append(node)
                needed |= {*node.input}
        inputs = [value for value in self.graph.input if value.name in needed - self.values.keys()]
        if len(inputs) != 1:
            got = f"got {', '.join(value.name for value in inputs) or 'none'}; export the actor alone"
            raise ConfigError(f"policy {self.file}: expected one input, what it sees, {got}")
        kind = inputs[0].type.tensor_type
        sizes = [d.dim_value for d in kind.shape.dim]
        if kind.elem_type not in self.floats or not all(sizes[1:] or sizes):
            got = f"{self.onnx.TensorProto.DataType.Name(kind.elem_type).lower()} of shape {sizes}, 0 for what is open"
            what = "an input of float or double whose shape is known but for the batch"
            raise ConfigError(f"policy {self.file}: expected {what}, got {got}; give an example of that shape")
        shape = [max(size, 1) for size in sizes]  # a batch is one
        self.count = self.size = int(np.prod(shape))
        self.values[inputs[0].name] = Slots(np.arange(self.count).reshape(shape))
        for node in reversed(nodes):
            results = self.read(node)
            if needed & {*node.output[len(results) :]} - {""}:
                raise self.refused(node)
            self.values |= zip(node.output, results, strict=False)
        actions = self.values[name or names[0]]
        if not isinstance(actions, Slots):
            raise ConfigError(f"policy {self.file}: expected actions by what it sees, got constants; export it again")
        finite = all(np.isfinite(a).all() for part in self.parts if isinstance(part, Affine) for a in (part.W, part.b))
        if not finite or any(np.isnan(a).any() for part in self.parts if isinstance(part, Each) for a in part.operands):
            raise ConfigError(f"policy {self.file}: expected finite weights, got others; train it again")
        return actions.at

    def read(self, node: Any) -> Sequence[Slots | np.ndarray]:
        """The results of a node. Raises ConfigError, with its name, for one that is not known."""
        attributes, op = {a.name: self.onnx.helper.get_attribute_value(a) for a in node.attribute}, node.op_type
        ours = node.domain in ("", "ai.onnx") and not op.startswith(RANDOM) and op[:1].isupper()
        try:
            inputs = [self.values[name] if name else None for name in node.input]
            vary = [isinstance(a, Slots) for a in inputs]
            if ours and (not any(vary) or op == "Shape" or (op in MOVES and (op == "Concat" or not any(vary[1:])))):
                return self._moved(node, inputs, any(vary) and op != "Shape")
            if ours and op in FORMULAS:
                return [self._formula(op, inputs, attributes)]
            if ours and hasattr(self, op):
                return [Slots(getattr(self, op)(*inputs, **attributes))]
        except Exception:  # of operands that are not taken
            pass
        raise self.refused(node)

    def refused(self, node: Any) -> ConfigError:
        """The error that names a node."""
        op = node.op_type
        what = f"expected operations of a network as MatMul and Tanh, got {op} (node {node.name or node.output[0]})"
        return ConfigError(f"policy {self.file}: {what}; export the mean of the actor alone")

    def _moved(self, node: Any, inputs: Sequence[Any], vary: bool) -> list[Slots | np.ndarray]:
        """The results of ONNX's reference on constants, or on slots as it would move the numbers there."""
        if node.op_type == "Concat" and vary:
            inputs = [a if isinstance(a, Slots) else self.each("Identity", a) for a in inputs]
        infos = [[self.onnx.ValueInfoProto(name=name) for name in names if name] for names in (node.input, node.output)]
        graph = self.onnx.helper.make_graph([node], "node", *infos)
        evaluator = self.onnx.reference.ReferenceEvaluator(graph, opsets={o.domain: o.version for o in self.opsets})
        feeds = {k: a.at if isinstance(a, Slots) else a for k, a in zip(node.input, inputs, strict=True) if k}
        return [Slots(a) if vary else a for a in evaluator.run(None, feeds)]

    def _formula(self, op: str, inputs: Sequence[Any], attributes: dict[str, Any]) -> Slots:
        """A formula of numbers; its settings are attributes, or inputs, by the age of the graph."""
        operands, settings = [*inputs], DEFAULTS.get(op, {})
        if attributes.keys() - settings:
            raise ValueError
        for k, (name, value) in enumerate(settings.items(), start=1):
            if k >= len(operands) or operands[k] is None:
                operands[k : k + 1] = [attributes.get(name, value)]
        if op in ("Max", "Min"):
            return reduce(partial(self.each, op), operands)
        return self.each(op, *operands)

    def each(self, op: str, *operands: Slots | np.ndarray | float) -> Slots:
        """A formula of numbers, broadcast."""
        arrays = [a.at if isinstance(a, Slots) else np.asarray(a, dtype=float) for a in operands]
        arrays = np.broadcast_arrays(*arrays)
        if not arrays[0].size:
            return Slots(np.zeros(arrays[0].shape, dtype=int))
        self.parts.append(Each(op, tuple(a.ravel() for a in arrays)))
        return Slots(self._next(arrays[0].size).reshape(arrays[0].shape))

    def affine(self, x: np.ndarray, W: np.ndarray, b: np.ndarray | float = 0.0) -> np.ndarray:
        """x W + b for slots x (..., in) and W (in, out)."""
        if W.ndim != 2 or x.shape[-1] != len(W):
            raise ValueError
        rows = x.reshape(-1, x.shape[-1])
        b = np.broadcast_to(np.asarray(b, dtype=float), (len(rows), W.shape[1]))
        slots = []
        for row, bias in zip(rows, b, strict=True):
            if (np.diff(row) != 1).any():
                row = self.each("Identity", Slots(row)).at
            self.parts.append(Affine(int(row[0]), np.ascontiguousarray(W, dtype=float), bias.copy()))
            slots.append(self._next(len(bias)))
        return np.array(slots).reshape(*x.shape[:-1], -1)

    def _next(self, size: int) -> np.ndarray:
        self.size += size
        return np.arange(self.size - size, self.size)

    def Cast(self, x: Slots, to: int) -> np.ndarray:
        if to not in self.floats:  # shorter ones round
            raise ValueError
        return x.at

    def MatMul(self, a: Any, b: Any) -> np.ndarray:
        if isinstance(a, np.ndarray):
            vector = b.at.ndim == 1
            return self.affine(b.at, a.T) if vector else self.affine(b.at.swapaxes(-1, -2), a.T).swapaxes(-1, -2)
        return self.affine(a.at, b) if b.ndim == 2 else self.affine(a.at, b[:, None])[..., 0]

    def Gemm(
        self, a: Slots, b: Any, c: Any = 0.0, alpha: float = 1.0, beta: float = 1.0, transA: int = 0, transB: int = 0
    ) -> np.ndarray:
        x, W = a.at.T if transA else a.at, alpha * (b.T if transB else b)
        return self.affine(x, W, 0.0 if c is None else beta * c)

    def ReduceSum(self, x: Slots, axes: Any = None, keepdims: int = 1, noop_with_empty_axes: int = 0) -> np.ndarray:
        named = [] if axes is None else np.ravel(axes).tolist()
        over = tuple(named or range(x.at.ndim * (not noop_with_empty_axes)))
        shape = x.at.sum(over, keepdims=bool(keepdims)).shape
        rows = np.moveaxis(x.at, over, range(-len(over), 0)).reshape(math.prod(shape), -1)
        return self.affine(rows, np.ones((rows.shape[1], 1))).reshape(shape)

    def ReduceMean(self, x: Slots, axes: Any = None, keepdims: int = 1, noop_with_empty_axes: int = 0) -> np.ndarray:
        total = self.ReduceSum(x, axes, keepdims, noop_with_empty_axes)
        return self.each("Div", Slots(total), x.at.size / total.size).at

    def LayerNormalization(
        self, x: Slots, scale: Any, b: Any = 0.0, axis: int = -1, epsilon: float = 1e-5, **_: int
    ) -> np.ndarray:
        axes = range(axis % x.at.ndim, x.at.ndim)
        away = self.each("Sub", x, Slots(self.ReduceMean(x, axes)))
        spread = Slots(self.ReduceMean(self.each("Mul", away, away), axes))
        size = self.each("Sqrt", self.each("Add", spread, epsilon))
        return self.each("Add", self.each("Mul", self.each("Div", away, size), scale), 0.0 if b is None else b).at
