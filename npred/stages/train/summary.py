"""What the train stage says of its result."""

from npred.progress import counted
from npred.results import Trained


def summary(result: Trained, width: int | None = None) -> str:
    size = f"{result.parameters} parameters, {counted(result.epochs, 'epochs')} of {counted(result.samples, 'samples')}"
    return f"{result.model}: {size}; held-out rollouts: MSE {result.mse:.3g}, sup error {result.eps_sup:.3g}"
