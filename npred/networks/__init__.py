"""Ways to evaluate a trained operator: torch, one fused compiled function, ONNX Runtime, and C source."""

import numpy as np

from npred.base.registry import RUNTIMES
from npred.networks.fused import Fused, Loaded, lowering
from npred.networks.weights import TrainedOperator
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods.base import Predictor
from npred.prediction.methods.runge_kutta import RK4

Samples = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # X (B, n), u (B, nx, m), D_hat and t (B,)


def predictor(
    runtime: str | None, plant: Plant, operator: TrainedOperator, nx: int = 101, name: str = "neural",
    device: str = "cpu",
) -> Predictor:  # fmt: skip
    """The operator as a predictor in a runtime, by its name or `my_runtime.py:Mine`; only torch uses the device.

    None: the fastest that fits, npred.networks.fused.Loaded, or torch on a GPU and for a network without a fused form.
    Raises ConfigError for another name or a class that is no Predictor, MissingError for torch or onnx without its
    extra.
    """
    if runtime is None and device == "cpu" and lowering(operator) and not problem_of(plant).refusal("fused"):
        return Loaded(plant, operator, nx, name=name)
    kind = RUNTIMES.subclass("runtime", runtime or "torch", Predictor)
    return kind(plant, operator if issubclass(kind, Fused) else operator.module(plant), nx, name=name, device=device)


def eps(plant: Plant, P_hat: np.ndarray, samples: Samples) -> float:
    """The largest |P̂ - P| over samples and nodes, P by RK4 on the nodes of P_hat (B, nx, n)."""
    P = RK4(plant, P_hat.shape[1])(*samples)
    return float(np.linalg.norm(P_hat - P, axis=-1).max())
