"""npred: predictor feedback for delayed nonlinear plants, with numerical predictors and measured neural ones.

`plant` and `predictor` make the parts by name, `simulate` closes the loop; `generate`, `train` and `evaluate` are the
stages of the command line on its store, from which `load` takes a trained network; `controller` is the controller for a
real plant, `as_iosystem` that for python-control. DelayAdaptation is the paper's law for the delay estimate; DelayLaw
and Predictor are what a law and a predictor that you write derive from. npred.errors has the failures.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from npred import laws as laws
    from npred import plants as plants
    from npred.base import errors as errors
    from npred.diagnosis.delay_margin import delay_margin
    from npred.estimation import observers as observers
    from npred.estimation.adaptation import DelayAdaptation
    from npred.estimation.delay_law import DelayLaw
    from npred.estimation.delay_observer import DelayObserver
    from npred.estimation.l1_adaptation import L1Adaptation
    from npred.exports import export
    from npred.guard.guarded import guarded
    from npred.identification.identify import identify
    from npred.lab.scheduler.models import load
    from npred.lab.scheduler.runs import evaluate, generate, train
    from npred.lab.stages.bench.comparison import compare
    from npred.laws.policy import policy
    from npred.loop import lyapunov as lyapunov
    from npred.loop import metrics as metrics
    from npred.loop.closed_loop import simulate
    from npred.loop.controller import controller
    from npred.loop.iosystem import as_iosystem
    from npred.loop.loop import Loop
    from npred.loop.measurement import Measurement
    from npred.loop.safety import SafetyFilter
    from npred.loop.timing import Timing
    from npred.loop.watchdog import Watchdog
    from npred.plants import plant
    from npred.prediction.methods import Predictor, predictor

__version__ = "1.0.0"
__all__ = [
    "DelayAdaptation", "DelayLaw", "DelayObserver", "L1Adaptation", "Loop", "Measurement", "Predictor", "SafetyFilter",
    "Timing", "Watchdog", "as_iosystem", "compare", "controller", "delay_margin", "evaluate", "export", "generate",
    "guarded", "identify", "load", "plant", "policy", "predictor", "simulate", "train",
]  # fmt: skip

_HOME = {
    "DelayAdaptation": "estimation.adaptation",
    "DelayLaw": "estimation.delay_law",
    "DelayObserver": "estimation.delay_observer",
    "L1Adaptation": "estimation.l1_adaptation",
    "Loop": "loop.loop",
    "Measurement": "loop.measurement",
    "Predictor": "prediction.methods",
    "SafetyFilter": "loop.safety",
    "Timing": "loop.timing",
    "Watchdog": "loop.watchdog",
    "as_iosystem": "loop.iosystem",
    "compare": "lab.stages.bench.comparison",
    "controller": "loop.controller",
    "delay_margin": "diagnosis.delay_margin",
    "export": "exports",
    "guarded": "guard.guarded",
    "identify": "identification.identify",
    "load": "lab.scheduler.models",
    "plant": "plants",
    "policy": "laws.policy",
    "predictor": "prediction.methods",
    **dict.fromkeys(("evaluate", "generate", "train"), "lab.scheduler.runs"),
    "simulate": "loop.closed_loop",
}
# as npred.errors
_MODULES = {"errors": "base.errors", "laws": "laws", "observers": "estimation.observers", "plants": "plants"}
_MODULES |= {"metrics": "loop.metrics", "lyapunov": "loop.lyapunov"}


def _attribute(name: str) -> Any:
    """The public names, imported on first use: torch takes seconds that `npred --help` has no use for."""
    if name not in (*_HOME, *_MODULES):
        from npred.base.errors import similar

        raise AttributeError(f"module 'npred' has no attribute {name!r}{similar(name, (*_HOME, *_MODULES))}")
    import importlib

    if name in _MODULES:
        return importlib.import_module(f"npred.{_MODULES[name]}")
    return getattr(importlib.import_module(f"npred.{_HOME[name]}"), name)


if not TYPE_CHECKING:  # a checker has the imports above, and says which names there are not
    __getattr__ = _attribute


def __dir__() -> list[str]:
    """The public names, before their first use too."""
    return sorted({*__all__, *_MODULES, "__doc__", "__version__"})
