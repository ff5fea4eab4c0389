"""Ways to evaluate a trained operator: torch, one fused compiled function, ONNX Runtime, and C source."""

from npred.operators import Operator
from npred.plants.base import Plant
from npred.predictors.base import Predictor
from npred.registry import RUNTIMES


def predictor(
    runtime: str, plant: Plant, operator: Operator, nx: int = 101, name: str = "neural", device: str = "cpu"
) -> Predictor:
    """The operator as a predictor in a runtime, by its name or `my_runtime.py:Mine`; only torch uses the device.

    Raises ConfigError for another name or a class that is no Predictor, MissingError for onnx without its extra.
    """
    kind = RUNTIMES.subclass("runtime", runtime, Predictor)
    return kind(plant, operator, nx, name=name, device=device)
