"""A trained operator as one compiled function on a fixed grid: lowered to a program, which is printed as C.

The scalings and the anchor are lowered here, each network in another file.
"""

import math
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from npred.base import grid
from npred.base.errors import ConfigError, installed
from npred.base.registry import NETWORKS, RUNTIMES, short_name
from npred.kernels.c_text import constant, literal
from npred.kernels.kernel import Kernel, made, skeleton
from npred.networks.program import Matrix, Program
from npred.networks.weights import TrainedOperator
from npred.plants.base import Plant
from npred.prediction.delays import problem, problem_of
from npred.prediction.methods.base import Compiled, Predictor

COARSE = 100  # intervals that an FNO is evaluated on, at least
# 2^f on [-1/2, 1/2], to 2e-7 of the value and to 2e-16; (e^d - 1) / d on [-1/2, 1/2]: Taylor's, but for the shortest
EXP2 = {
    np.float32: [1.0000001192, 0.6931471825, 0.2402210683, 0.0555035696, 0.0096760318, 0.0013390863],
    np.float64: [math.log(2) ** k / math.factorial(k) for k in range(13)],
}
EXPM1 = {kind: [1 / math.factorial(k + 1) for k in range(terms)] for kind, terms in ((np.float32, 7), (np.float64, 13))}
KINDS = {np.dtype(np.float32): "float", np.dtype(np.float64): "double"}
RENAMED = {"N": "N_"}  # buffers whose names are macros


class Fused(Compiled):
    """P_hat of a trained operator by one compiled function on one core, without Python.

    It is compiled for a grid, the weights in it, and kept on the disk like every kernel; loops with it run in the
    compiled engine. Another nx in a call compiles another function. `precision` of the network is np.float32 or
    np.float64. Equal to the operator up to its rounding, but for an FNO on a fine grid: it is evaluated on every
    `stride`-th node, cubics between, by default so that COARSE intervals or more are left. At those nodes, x = 1 among
    them, it is exact too. Raises ConfigError for a network that cannot be lowered.
    """

    def __init__(
        self, plant: Plant, operator: TrainedOperator, nx: int = 101, name: str = "neural", stride: int | None = None,
        precision: type[np.floating] = np.float32, device: str = "cpu",
    ) -> None:  # fmt: skip
        super().__init__(plant, nx)
        require(operator, "fused", "use the runtime torch or onnx", "" if name == "neural" else name)
        self.name, self.stride, self.precision = name, stride, precision  # type: ignore[misc]
        self.operator, self.kernels = operator, {}

    def compile(self) -> Kernel:
        return self.on(self.nx)

    def on(self, nx: int) -> Kernel:
        if nx not in self.kernels:
            stride = self.stride or coarsest(nx)
            self.kernels[nx] = kernel(fold(self.operator, self.plant, nx, stride, self.precision))
        return self.kernels[nx]

    def __getstate__(self) -> dict[str, Any]:
        """The operator; its functions are compiled again, or read from the disk, on use."""
        return super().__getstate__() | {"kernels": {}}


class Loaded(Predictor):
    """A trained operator as npred.load gives it: torch in calls, one compiled function in loops and controllers.

    Torch takes any batch and grid. Both are in double precision, equal up to rounding, but for an FNO on a fine grid
    (Fused). Nothing is compiled before the first loop asks for `lanes`; an evaluation on as many nodes has left the
    same function on the disk. Without torch calls are compiled too, for each grid that one asks for, every node
    evaluated.
    """

    def __init__(self, plant: Plant, operator: TrainedOperator, nx: int = 101, name: str = "neural") -> None:
        super().__init__(plant, nx)
        require(operator, "fused", "use the runtime torch or onnx", "" if name == "neural" else name)
        self.name, self.operator = name, operator  # type: ignore[misc]

    @property
    def compiled(self) -> bool:
        return True

    @cached_property
    def fused(self) -> Fused:
        """The operator as the function that a loop calls."""
        return Fused(self.plant, self.operator, self.nx, self.name, precision=np.float64)

    @cached_property
    def calls(self) -> Predictor:
        """The operator as calls evaluate it."""
        if not installed("torch"):
            return Fused(self.plant, self.operator, self.nx, self.name, stride=1, precision=np.float64)
        torch = RUNTIMES.subclass("runtime", "torch", Predictor)
        return torch(self.plant, self.operator, self.nx, name=self.name)

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        return self.calls.predict(X, u, D_hat, t)

    def lanes(self) -> Kernel:
        return self.fused.on(self.nx)


def coarsest(nx: int) -> int:
    """The largest stride that divides the intervals and leaves COARSE of them, or 1."""
    intervals = nx - 1
    return max(s for s in range(1, max(intervals // COARSE, 1) + 1) if intervals % s == 0)


def lowering(operator: TrainedOperator) -> str:
    """The module that lowers the operator's network, empty where there is none."""
    entry = NETWORKS.builtin.get(operator.architecture)
    return entry.fused if entry else ""


def require(operator: TrainedOperator, what: str, cure: str, name: str = "") -> None:
    """Raise ConfigError, after `what` needs it, unless the operator's network can be lowered; `name`: its own."""
    if not lowering(operator):
        names = ", ".join(name for name, entry in NETWORKS.builtin.items() if entry.fused)
        name = name or short_name(operator.architecture)
        raise ConfigError(f"{what}: expected a network that can be lowered ({names}), got {name}; {cure}")


def fold(
    operator: TrainedOperator, plant: Plant, nx: int, stride: int = 1, precision: type[np.floating] = np.float32
) -> Program:
    """The operator on nx nodes as a program; an FNO is evaluated on every stride-th of them, with cubics between.

    `precision` is that of the network: np.float32 or np.float64.

    Raises ConfigError for a network without a program, a plant whose delays have none, or whose time has no period.
    """
    plant.phase(0.0)
    problem_of(plant).needs("fused")
    require(operator, "fold", "use the runtime torch or onnx")
    network, weights = import_module(lowering(operator)), operator.weights().exact(plant)
    rows = 2 if network.PAIRED and weights.anchor == "equilibrium" else 1
    period = plant.period if plant.phased else None
    p = Program(plant.n, plant.m, nx, rows, stride if network.STRIDED else 1, period, precision=precision)
    # z and v are zero at rest, or at the mean of the data
    rests = weights.anchor == "equilibrium"
    X_bend, X_mean, X_std = (weights[f"scaling.X_{part}"] for part in ("bend", "mean", "std"))
    u_mean, u_std = weights["scaling.u_mean"], weights["scaling.u_std"]
    X_zero = np.arcsinh(weights["X_rest"] / X_bend) if rests else X_mean
    u_zero = weights["u_rest"] if rests else u_mean
    scales = {"X_bend": 1 / X_bend, "X_zero": X_zero, "X_gain": 1 / X_std, "u_zero": u_zero, "u_gain": 1 / u_std}
    scales |= {"D_hat_zero": weights["scaling.D_hat_mean"], "D_hat_gain": 1 / weights["scaling.D_hat_std"]}
    for name, values in scales.items():
        p.scale(name, values)
    p.scale("halves", 0.5 / np.maximum(np.arange(nx), 1))  # 0.5 / j: a division costs more than a number read
    p.z_zero, p.v_zero = (X_zero - X_mean) / X_std, (u_zero - u_mean) / u_std
    network.append(p, weights)
    if p.stride > 1:
        p.buffer("N_fine", plant.n, nx)
        # the weights (3, 4, stride) of four nodes in the points of the first cell, of those between, and of the last
        places = np.array([0, min(1, p.nodes - 2), p.nodes - 2])[:, None] + np.arange(p.stride) / p.stride
        _, between = grid.stencil(p.nodes, places.ravel() / (p.nodes - 1))
        p.constant("refine", between.reshape(4, 3, p.stride).swapaxes(0, 1))
    if weights.anchor == "none":
        p.scale("base", weights["scaling.P_mean"])
        p.constant("gain", np.repeat(weights["scaling.P_std"][:, None], nx, axis=1))
    else:
        p.constant("gain", weights["scaling.speed"][:, None] * grid.nodes(nx))
    return p


def kernel(p: Program) -> Kernel:
    """PREDICT by a program, for p.nx nodes and any number of lanes: operations are calls on constants and buffers."""
    functions = {"operations": p.operations} | ({"series": [p.series.product]} if p.series else {})
    members = "\n".join(f"    LINED REAL {RENAMED.get(name, name)}[{size}];" for name, size in p.buffers.items())
    texts = [f"typedef struct {{\n    double prefix[NX];\n{members}\n}} ALIASED PART(_memory);\n"]
    for name, operations in functions.items():
        lines = "\n    ".join(line for operation in operations for line in operation.lines(_view(p)))
        texts.append(f"static void PART(_{name})(PART(_memory) *restrict q)\n{{\n    {lines}\n}}\n")
    constants = ["LINED " + constant(f"c_{name}", values, KINDS[values.dtype]) for name, values in p.constants.items()]
    doubles = sum(map(p.rounded, [16, p.nx, *p.buffers.values()]))  # scratch memory, for numbers of either precision
    body = "\n".join([skeleton("network.h"), *constants, *texts, skeleton("fused.h")])
    numbers, kind = np.finfo(p.precision), KINDS[np.dtype(p.precision)]
    exp2, expm1 = (f"{{{', '.join(literal(c, kind) for c in of[p.precision])}}}" for of in (EXP2, EXPM1))
    sizes: dict[str, int | str] = {
        "N": p.n, "M": p.m, "NX": p.nx, "NODES": p.nodes, "STRIDE": p.stride, "SEEN": p.seen, "COLUMNS": p.columns,
        "REAL": kind, "INTEGER": f"int{numbers.bits}_t", "UNSIGNED": f"uint{numbers.bits}_t",
        "MANTISSA": numbers.nmant, "EXPONENT": numbers.maxexp - 1, "EXP2": exp2, "EXPM1": expm1,
        "PHASED": int(bool(p.period)), "PERIOD": repr(p.period or 1.0), "PAIRED": int(p.rows == 2),
        "TWICE": int(p.twice), "SERIES_TERMS": p.series.terms if p.series else 0, "BASED": int("base" in p.constants),
    }  # fmt: skip
    if p.series:
        sizes |= {"SERIES_LOW": repr(p.series.low), "SERIES_SCALE": repr(2 / (p.series.high - p.series.low))}
    return made("fused", problem.PREDICT, body, {}, sizes, work=lambda nx, lanes, _: doubles, loose=True)


def _view(p: Program) -> Callable[[Matrix | None], str]:
    """The C of a matrix of the program: where its first element is, and its strides."""

    def text(matrix: Matrix | None) -> str:
        if matrix is None:
            return "0, (View){0, 0}"
        name = f"q->{RENAMED.get(matrix.name, matrix.name)}" if matrix.name in p.buffers else f"c_{matrix.name}"
        moves = {"": matrix.offset, " * e": matrix.turn, " * o": matrix.layer}
        place = name + "".join(f" + {count}{index}" for index, count in moves.items() if count)
        return f"{place}, (View){{{matrix.row}, {matrix.column}}}"

    return text
