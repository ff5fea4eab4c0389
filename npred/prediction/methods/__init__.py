"""Predictors: maps from (X, u, D_hat) to P."""

from npred.base.errors import ConfigError
from npred.base.registry import METHODS, Method
from npred.plants.base import Plant, require
from npred.prediction.methods.base import Compiled, OneStep, Predictor
from npred.prediction.methods.picard import Picard
from npred.prediction.methods.runge_kutta import RK4, Euler, Heun

__all__ = ["Compiled", "Euler", "Heun", "OneStep", "Picard", "Predictor", "RK4", "method", "numerical", "predictor"]


def method(spec: str, what: str = "predictor") -> type[Predictor]:
    """The numerical predictor of a name or of a class of a file, my_method.py:Ralston; `what` names it in messages.

    Raises ConfigError, in one line, for one that is missing, broken or no predictor.
    """
    kind = METHODS.subclass(what, spec, Predictor)
    if spec not in METHODS.builtin and issubclass(kind, OneStep):
        kind.evaluations()
    return kind


def predictor(plant: Plant, method: Method | str, nx: int = 101) -> Predictor:
    """The numerical predictor of a plant, on nx nodes in a loop [DAPF, eq. 10].

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    method : "euler", "heun", "rk4", "picard", one of a package, or a class of a file, "my_method.py:Ralston"
        The method.
    nx : int, default 101
        Nodes on [0, 1], both ends included.

    Returns
    -------
    Predictor
        P(x) = X + D_hat ∫₀ˣ f(P(y), u(y)) dy on nx uniform nodes, both ends in [DAPF, eq. 10].

    Raises
    ------
    ConfigError
        For an unknown or broken method, for fewer than two nodes, or for what is no plant.
    """
    require(plant)
    return numerical(method, plant, nx)


def numerical(spec: str, plant: Plant, nx: int = 101) -> Predictor:
    """The numerical predictor of that name on nx nodes. Raises ConfigError as `method` does, or where it is refused."""
    kind = method(spec)
    try:
        return kind(plant, nx)
    except TypeError as error:
        raise ConfigError(f"predictor {spec}: expected a class that takes (plant, nx), got: {error}") from None
