"""The predictor operator (X, u, D_hat) -> P as networks, their scaling, anchors and files."""

from npred.operators.base import Operator, build, checked
from npred.operators.io import describe, load, save
from npred.operators.scaling import Scaling

__all__ = ["Operator", "Scaling", "build", "checked", "describe", "load", "save"]
