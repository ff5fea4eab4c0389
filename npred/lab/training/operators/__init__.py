"""The predictor operator (X, u, D_hat) -> P as networks, their scaling, anchors and files.

Weights are read without torch; what else is here are torch modules, imported on first use.
"""

from typing import TYPE_CHECKING, Any

from npred.base.errors import imported
from npred.networks.weights import TrainedOperator, Weights, describe, read

if TYPE_CHECKING:
    from npred.lab.training.operators.base import Operator as Operator
    from npred.lab.training.operators.base import build as build
    from npred.lab.training.operators.base import checked as checked
    from npred.lab.training.operators.io import load as load
    from npred.lab.training.operators.io import save as save
    from npred.lab.training.operators.scaling import Scaling as Scaling

__all__ = ["Operator", "Scaling", "TrainedOperator", "Weights", "build", "checked", "describe", "load", "read", "save"]

_HOME: dict[str, str] = {
    "Operator": "base", "build": "base", "checked": "base", "load": "io", "save": "io", "Scaling": "scaling",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """What needs torch. Raises MissingError without it."""
    if name not in _HOME:
        raise AttributeError(f"module 'npred.lab.training.operators' has no attribute {name!r}")
    return getattr(imported("networks", f"npred.lab.training.operators.{_HOME[name]}"), name)
