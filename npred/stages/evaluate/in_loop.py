"""The error of the prediction in a closed loop: against the state one delay later, where the delay is known.

Errors on data compare a network with a numerical predictor on the same (X, u, D_hat). They cannot show what the
numerical predictor, or the u that the loop gives to it, is wrong by. This error can: nothing is its reference but the
plant.
"""

from collections.abc import Callable

import numpy as np

from npred import randomness
from npred.config import Evaluate
from npred.loop import configured, metrics
from npred.plants import Plant
from npred.predictors import Predictor
from npred.results.evaluate import InLoop
from npred.stages import Job
from npred.stages.evaluate.initial_conditions import Starts

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


def steps(config: Evaluate, begin: Starts) -> int:
    """The control steps of one contender's loops."""
    return len(states(begin)) * (round(length(config) / config.dt) + 1)


def error(job: Job, predictor: Predictor, begin: Starts, progress: Callable[[int], None]) -> float:
    """The largest metrics.in_loop of loops in which D_hat = D throughout; infinite where one is lost."""
    config, D = job.config.evaluate, delay(job.config.evaluate)
    loops = configured.loops(
        job.plant, predictor, config, D=D, D_hat=D, X0=states(begin), t_end=length(config), adapts=False,
        seed=randomness.integer(job.config.seed, "evaluate", "in the loop"), progress=progress,
    )  # fmt: skip
    errors = metrics.in_loop_declared(loops) if job.plant.declares_delay else metrics.in_loop(loops, D)
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
