"""Predictors: maps from (X, u, D_hat) to P."""

from npred.predictors.base import Compiled, Predictor
from npred.predictors.euler import Euler
from npred.predictors.heun import Heun
from npred.predictors.picard import Picard
from npred.predictors.rk4 import RK4

METHODS: dict[str, type[Compiled]] = {method.name: method for method in (Euler, Heun, RK4, Picard)}

__all__ = ["METHODS", "Compiled", "Euler", "Heun", "Picard", "Predictor", "RK4"]
