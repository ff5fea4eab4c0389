"""A trained operator as an ONNX graph with its control law, and as a predictor that ONNX Runtime evaluates."""

import copy
import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from npred.base import grid
from npred.base.errors import NpredError, required
from npred.exports import Exported, NetworkAlone
from npred.networks import eps
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods.base import Predictor

OPSET = 18  # MATLAB, TensorRT and ONNX Runtime read it
INPUTS, OUTPUTS = ("X", "u", "D_hat"), ("P", "U")


class Deployed(nn.Module):
    """X (B, n), u (B, nx, m), D_hat (B,) to P (B, nx, n) and U (B, m), U_j = kappa_j(P(r_j)), r_j = 1 for one delay.

    Without bounds [DAPF, eq. 9]. A plant that depends on time takes t (B,) too, the time now: its network sees the
    phase of t, and U_j = kappa_j(P(r_j), t + r_j D_hat) as in the closed loop; P(r_j) is cubic between nodes.
    """

    def __init__(self, operator: Any, plant: Plant):
        super().__init__()
        self.operator, self.plant, self.period = operator, plant, plant.period if plant.phased else None

    def forward(self, X: Tensor, u: Tensor, D_hat: Tensor, t: Tensor | None = None) -> tuple[Tensor, Tensor]:
        plant = self.plant
        P = self.operator(X, u, D_hat, None if self.period is None or t is None else t / self.period % 1)
        if plant.one_delay:
            return P, plant.kappa(P[:, -1], 0.0 if t is None else t + D_hat)
        U = []
        for j, r in enumerate(plant.ratios.tolist()):
            first, weights = grid.stencil(P.shape[1], np.array([r]))
            at_r = sum(float(weight[0]) * P[:, int(first[0]) + k] for k, weight in enumerate(weights))
            U.append(plant.kappa(at_r, 0.0 if t is None else t + r * D_hat)[:, j])
        return P, torch.stack(U, dim=-1)


def inputs(plant: Plant) -> tuple[str, ...]:
    return INPUTS if plant.rests and not plant.phased else (*INPUTS, "t")


def graph(operator: Any, plant: Plant, nx: int) -> bytes:
    """The ONNX model of P and U on nx nodes, any batch: values that depend on the grid alone are constants.

    Raises MissingError without the onnx extra, ConfigError where the plant is not traced, its time has no period, or a
    delay that it declares lets the law's time be another than t + D_hat.
    """
    for name in ("onnx", "onnxscript"):
        required("onnx", name, name, "onnx")
    problem_of(plant).needs("onnx")
    plant.phase(0.0)
    model = Deployed(operator, plant).eval()
    batch = torch.export.Dim("batch")
    names = inputs(plant)
    sample = (torch.ones(2, plant.n), torch.zeros(2, nx, plant.m), torch.ones(2), torch.ones(2))[: len(names)]
    model(*sample)  # the grid's matrices are cached as tensors before the tracer sees them
    with _quiet():
        options = {"input_names": names, "output_names": OUTPUTS, "opset_version": OPSET, "external_data": False}
        shapes = tuple({0: batch} for _ in names)
        program = torch.onnx.export(model, sample, dynamo=True, dynamic_shapes=shapes, verbose=False, **options)
    assert program is not None
    return program.model_proto.SerializeToString()


def export(of: NetworkAlone, path: Path, *, atol: float) -> Exported:
    """Write the graph of a network unless it differs from the network in single precision.

    Raises NpredError for a difference above `atol`, in units of the states and inputs, MissingError without the onnx
    extra.
    """
    plant, names = of.plant, inputs(of.plant)
    operator = copy.deepcopy(of.operator.module(plant)).float()  # the caller's network stays as it is
    model = graph(operator, plant, of.nx)
    columns = [np.asarray(a, dtype=np.float32) for a in of.samples][: len(names)]
    with torch.no_grad():
        expected = Deployed(operator, plant)(*map(torch.as_tensor, columns))
    outputs = session(model).run(list(OUTPUTS), dict(zip(names, columns, strict=True)))
    error = max(float(np.abs(a - b.numpy(force=True)).max()) for a, b in zip(outputs, expected, strict=True))
    if not error <= atol:
        raise NpredError(f"export onnx: expected P and U within {atol:g} of the model, got {error:.3g}; raise atol")
    path.write_bytes(model)
    return of.exported(path, (error, eps(plant, outputs[0].astype(float), of.samples)))


class Onnx(Predictor):
    """P_hat of a trained operator, evaluated by ONNX Runtime on one thread of the CPU in float32.

    The graph holds for a grid; another nx in a call makes another one. Raises MissingError without the onnx extra.
    """

    def __init__(self, plant: Plant, operator: Any, nx: int = 101, name: str = "neural", device: str = "cpu"):
        super().__init__(plant, nx)
        self.name = name  # type: ignore[misc]
        self.operator, self.graphs, self.sessions = operator.to("cpu").float().eval(), {}, {}
        self.on(nx)

    def on(self, nx: int) -> Any:
        if nx not in self.graphs:
            self.graphs[nx] = graph(self.operator, self.plant, nx)
        if nx not in self.sessions:
            self.sessions[nx] = session(self.graphs[nx])
        return self.sessions[nx]

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Any) -> np.ndarray:
        columns = X, u, D_hat, np.broadcast_to(t, len(X))
        arrays = (np.ascontiguousarray(a, dtype=np.float32) for a in columns)
        feed = dict(zip(inputs(self.plant), arrays, strict=False))
        return self.on(u.shape[1]).run(["P"], feed)[0].astype(float)

    def __getstate__(self) -> dict[str, Any]:
        """The graphs' bytes; sessions are opened again on use."""
        return super().__getstate__() | {"sessions": {}}


def session(model: bytes) -> Any:
    """An ONNX Runtime session on one thread of the CPU."""
    runtime = required("onnx", "onnxruntime", "onnxruntime", "onnx")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the exporter's warnings: of its deprecations, and of packages that no operator here needs.

    The exporter imports triton, which is for GPUs. At the end of the process triton's binding lists objects that it
    did not free. Without a GPU triton stays out.
    """
    levels = {name: logging.getLogger(name).level for name in ("torch.onnx", "torch.utils.flop_counter")}
    for name in levels:
        logging.getLogger(name).setLevel(logging.ERROR)
    absent = {} if "triton" in sys.modules or torch.cuda.is_available() else {"triton": None}
    sys.modules.update(absent)  # type: ignore[arg-type]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for name in absent:
            del sys.modules[name]
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
