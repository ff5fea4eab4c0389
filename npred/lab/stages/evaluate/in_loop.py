"""The error of the prediction in a closed loop: against the state one delay later, where the delay is known.

Errors on data compare a network with a numerical predictor on the same (X, u, D_hat). They cannot show what the
numerical predictor, or the u that the loop gives to it, is wrong by. This error can: nothing is its reference but the
plant.
"""

from collections.abc import Callable

import numpy as np

from npred.base import randomness
from npred.lab.config import Evaluate, Pipeline
from npred.lab.config.conditions import Condition, Starts
from npred.lab.config.results.evaluate import InLoop
from npred.loop import metrics
from npred.plants import Plant
from npred.prediction.methods import Predictor

LONGEST = 40.0  # seconds of a loop: transients are over by then
SHORTEST = 4  # delays: two of them pass before the error is taken, and the last one has nothing to compare with


def delay(config: Evaluate) -> float:
    """The nearest whole number of control steps to D, in seconds: there X(t + D) is on a step, and not interpolated."""
    return max(round(config.D / config.dt), 1) * config.dt


def length(config: Evaluate) -> float:
    """The length of these loops, in seconds."""
    return max(min(LONGEST, config.case_t_end), SHORTEST * delay(config))


def states(begin: Starts) -> np.ndarray:
    """Where they start, (B, n): the state of Fig. 1, then the initial states of the cases."""
    return np.concatenate([begin.X0[:1], begin.X0[begin.cases][:: begin.repeats]])


def condition(pipeline: Pipeline, begin: Starts) -> Condition:
    """Loops in which D_hat = D throughout."""
    config, D = pipeline.evaluate, delay(pipeline.evaluate)
    seed = randomness.integer(pipeline.seed, "evaluate", "in the loop")
    return Condition(config, states(begin), D, D, length(config), seed, adapts=False)


def error(plant: Plant, predictor: Predictor, at_D: Condition, progress: Callable[[int], None]) -> float:
    """The largest metrics.in_loop of the loops of `condition`; infinite where one is lost."""
    loops = at_D.loops(plant, predictor, progress=progress)
    errors = metrics.in_loop_declared(loops) if plant.declares_delay else metrics.in_loop(loops, at_D.D)
    return float(errors.max())


def about(plant: Plant, config: Evaluate, begin: Starts) -> InLoop:
    """What the error is of: D = D_hat in seconds, the times that it is the largest over, and how many loops.

    Of a plant that declares its delay there is no such D, and the times differ by loop.
    """
    if plant.declares_delay:
        return InLoop(D=None, start=None, to=length(config), loops=len(states(begin)))
    D = delay(config)
    D, start, to = (round(t, 9) for t in (D, 2 * D, length(config) - D))  # 0.6, not 0.6…01
    return InLoop(D=D, start=start, to=to, loops=len(states(begin)))
