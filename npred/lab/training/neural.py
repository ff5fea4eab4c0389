"""A trained operator as a predictor: the one module that knows networks and the loop's memory."""

from contextlib import nullcontext

import numpy as np
import torch

from npred.base import devices
from npred.networks.weights import TrainedOperator
from npred.plants.base import Plant
from npred.prediction.methods.base import Predictor


class Neural(Predictor):
    """P_hat = operator(X, u, D_hat) on a device, with the call of every predictor [DAPF, Theorem 2].

    Where P depends on the time too, the operator sees its share of the plant's period.
    It computes in the operator's precision; one row, and all rows of a simulated loop, on one thread. The operator is
    free of resolution: any nx in a call; `nx` is what a loop uses.
    """

    def __init__(
        self, plant: Plant, operator: TrainedOperator, nx: int = 101, device: str = "cpu", name: str = "neural"
    ) -> None:
        super().__init__(plant, nx)
        self.name = name  # type: ignore[misc]
        self.operator, self.device = operator.module(plant).to(device).eval(), device

    @torch.inference_mode()
    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        dtype = self.operator.X_rest.dtype
        phase = (self.plant.phase(np.broadcast_to(t, len(X))),) if self.plant.phased else ()
        tensors = (torch.as_tensor(np.array(a, dtype=float)).to(self.device, dtype) for a in (X, u, D_hat, *phase))
        with devices.one_thread() if len(X) == 1 else nullcontext():
            return self.operator(*tensors).numpy(force=True).astype(float)
