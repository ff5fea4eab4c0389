"""The predictor operator (X, u, D_hat) -> P as networks in torch, their scaling, and their anchors.

What reads their files without torch is npred.networks.weights.
"""

from npred.lab.training.operators.base import Operator, build, checked, save
from npred.lab.training.operators.scaling import Scaling

__all__ = ["Operator", "Scaling", "build", "checked", "save"]
