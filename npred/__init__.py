"""npred: certified predictor feedback for delayed nonlinear plants, with numerical and neural predictors."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from npred.adaptation import DelayAdaptation as DelayAdaptation
    from npred.api import controller as controller
    from npred.api import load as load
    from npred.api import plant as plant
    from npred.api import predictor as predictor
    from npred.closed_loop import simulate as simulate
    from npred.delay_estimate import DelayLaw as DelayLaw

__version__ = "0.1.0"
__all__ = ["DelayAdaptation", "DelayLaw", "controller", "load", "plant", "predictor", "simulate"]

_HOME = dict.fromkeys(__all__, "api") | {
    "DelayAdaptation": "adaptation",
    "DelayLaw": "delay_estimate",
    "simulate": "closed_loop",
}


def __getattr__(name: str) -> Any:
    """The public names, imported on first use: numba and torch take seconds that `npred --help` has no use for."""
    if name not in _HOME:
        raise AttributeError(f"module 'npred' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"npred.{_HOME[name]}"), name)
