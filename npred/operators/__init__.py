"""The predictor operator (X, u, D_hat) -> P as networks: DeepONet and FNO, their scaling, anchors and files."""

from npred.operators.base import Operator
from npred.operators.build import build
from npred.operators.io import describe, load, save
from npred.operators.scaling import Scaling

__all__ = ["Operator", "Scaling", "build", "describe", "load", "save"]
