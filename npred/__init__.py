"""npred: predictor feedback for delayed nonlinear plants, with numerical predictors and measured neural ones.

`plant` and `predictor` make the parts by name, `simulate` closes the loop; `generate`, `train` and `evaluate` are the
stages of the command line on its store, from which `load` takes a trained network; `controller` is the controller for a
real plant, `as_iosystem` that for python-control. DelayAdaptation is the paper's law for the delay estimate; DelayLaw
and Predictor are what a law and a predictor that you write derive from. npred.errors has the failures.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from npred import errors as errors
    from npred import laws as laws
    from npred import observers as observers
    from npred import plants as plants
    from npred.diagnosis.delay_margin import delay_margin
    from npred.exports import export
    from npred.identification.identify import identify
    from npred.loop.adaptation import DelayAdaptation
    from npred.loop.closed_loop import simulate
    from npred.loop.controller import controller
    from npred.loop.delay_law import DelayLaw
    from npred.loop.delay_observer import DelayObserver
    from npred.loop.iosystem import as_iosystem
    from npred.loop.l1_adaptation import L1Adaptation
    from npred.loop.loop import Loop
    from npred.loop.measurement import Measurement
    from npred.loop.timing import Timing
    from npred.loop.watchdog import Watchdog
    from npred.pipeline.models import load
    from npred.plants import plant
    from npred.predictors import Predictor, predictor
    from npred.predictors.guarded import guarded
    from npred.runs import evaluate, generate, train
    from npred.safety import SafetyFilter
    from npred.stages.bench.comparison import compare

__version__ = "1.0.0"
__all__ = [
    "DelayAdaptation", "DelayLaw", "DelayObserver", "L1Adaptation", "Loop", "Measurement", "Predictor", "SafetyFilter",
    "Timing", "Watchdog", "as_iosystem", "compare", "controller", "delay_margin", "evaluate", "export", "generate",
    "guarded", "identify", "load", "plant", "predictor", "simulate", "train",
]  # fmt: skip

_HOME = {
    "DelayAdaptation": "loop.adaptation",
    "DelayLaw": "loop.delay_law",
    "DelayObserver": "loop.delay_observer",
    "L1Adaptation": "loop.l1_adaptation",
    "Loop": "loop.loop",
    "Measurement": "loop.measurement",
    "Predictor": "predictors",
    "SafetyFilter": "safety",
    "Timing": "loop.timing",
    "Watchdog": "loop.watchdog",
    "as_iosystem": "loop.iosystem",
    "compare": "stages.bench.comparison",
    "controller": "loop.controller",
    "delay_margin": "diagnosis.delay_margin",
    "export": "exports",
    "guarded": "predictors.guarded",
    "identify": "identification.identify",
    "load": "pipeline.models",
    "plant": "plants",
    "predictor": "predictors",
    **dict.fromkeys(("evaluate", "generate", "train"), "runs"),
    "simulate": "loop.closed_loop",
}
# as npred.errors
_MODULES = {name: name for name in ("errors", "laws", "observers", "plants")}
_MODULES |= {"metrics": "loop.metrics", "lyapunov": "loop.lyapunov"}


def __getattr__(name: str) -> Any:
    """The public names, imported on first use: torch takes seconds that `npred --help` has no use for."""
    if name not in (*_HOME, *_MODULES):
        from npred.errors import similar

        raise AttributeError(f"module 'npred' has no attribute {name!r}{similar(name, (*_HOME, *_MODULES))}")
    import importlib

    from npred.docstrings import documented

    if name in _MODULES:
        return importlib.import_module(f"npred.{_MODULES[name]}")
    return documented(getattr(importlib.import_module(f"npred.{_HOME[name]}"), name))


def __dir__() -> list[str]:
    """The public names, before their first use too."""
    return sorted({*__all__, *_MODULES, "__doc__", "__version__"})
