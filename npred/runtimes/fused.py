"""Networks as one compiled function: a whole call of the operator on the loop's memory, for a fixed grid."""

from collections.abc import Callable
from typing import Any

import numpy as np

from npred.operators import Operator
from npred.plants.base import Plant
from npred.predictors.base import Compiled
from npred.runtimes import network
from npred.runtimes.lower import fold, require

COARSE = 100  # intervals that an FNO is evaluated on, at least


class Fused(Compiled):
    """P_hat of a trained operator by one compiled function on one core, without Python.

    It is compiled for a grid, the weights in it, and kept on the disk like every kernel; loops with it run in the
    compiled engine. Another nx in a call compiles another function. `precision` of the network is np.float32 or
    np.float64. Equal to the operator up to its rounding, but for an FNO on a fine grid: it is evaluated on every
    `stride`-th node, cubics between, by default so that COARSE intervals or more are left. At those nodes, x = 1 among
    them, it is exact too. Raises ConfigError for a network that cannot be lowered.
    """

    def __init__(
        self, plant: Plant, operator: Operator, nx: int = 101, name: str = "neural", stride: int | None = None,
        precision: Any = np.float32, device: str = "cpu",
    ) -> None:  # fmt: skip
        super().__init__(plant, nx)
        require(operator, "fused", "use the runtime torch or onnx", "" if name == "neural" else name)
        self.name, self.stride, self.precision = name, stride, precision  # type: ignore[misc]
        self.operator, self.kernels = operator.to("cpu").eval(), {}

    def compile(self) -> Callable[..., None]:
        return self.on(self.nx)

    def on(self, nx: int) -> Callable[..., None]:
        if nx not in self.kernels:
            stride = self.stride or coarsest(nx)
            self.kernels[nx] = network.kernel(fold(self.operator, self.plant, nx, stride, self.precision))
        return self.kernels[nx]

    def __getstate__(self) -> dict[str, Any]:
        """The operator; its functions are compiled again, or read from the disk, on use."""
        return super().__getstate__() | {"kernels": {}}


def coarsest(nx: int) -> int:
    """The largest stride that divides the intervals and leaves COARSE of them, or 1."""
    intervals = nx - 1
    return max(s for s in range(1, max(intervals // COARSE, 1) + 1) if intervals % s == 0)
