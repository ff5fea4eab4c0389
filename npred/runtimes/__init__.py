"""Ways to evaluate a trained operator: torch, one fused compiled function, ONNX Runtime, and C source."""

from typing import TYPE_CHECKING

from npred.errors import ConfigError
from npred.operators import Operator
from npred.plants.base import Plant

if TYPE_CHECKING:
    from npred.predictors.neural import Neural
    from npred.runtimes.fused import Fused
    from npred.runtimes.onnx import Onnx

RUNTIMES = ("torch", "fused", "onnx")


def predictor(
    runtime: str, plant: Plant, operator: Operator, nx: int = 101, name: str = "neural", device: str = "cpu"
) -> "Neural | Fused | Onnx":
    """The operator as a predictor in one of RUNTIMES; a device is of use to torch alone.

    Raises ConfigError for another name, MissingError for onnx without its extra.
    """
    if runtime == "fused":
        from npred.runtimes.fused import Fused

        return Fused(plant, operator, nx, name)
    if runtime == "onnx":
        from npred.runtimes.onnx import Onnx

        return Onnx(plant, operator, nx, name)
    if runtime != "torch":
        raise ConfigError(f"runtime: expected one of {', '.join(RUNTIMES)}, got {runtime!r}; choose one")
    from npred.predictors.neural import Neural

    return Neural(plant, operator, nx, device, name)
