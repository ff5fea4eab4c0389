"""Networks as an evaluation runs them: compiled where that is possible."""

import numpy as np

from npred.predictors import Predictor
from npred.results import Contender
from npred.stages.job import Job


def load(job: Job, contender: Contender) -> Predictor:
    """The fused network, as it is deployed but in double precision: in float32 an FNO's loops end 3e-6 away.

    A network that cannot be lowered is evaluated by torch.
    """
    import torch

    from npred import operators
    from npred.predictors.neural import Neural
    from npred.runtimes.fused import Fused, lowering

    model, epoch, name = contender.model, contender.epoch, contender.name
    operator = operators.load(job.inputs[model], job.plant, epoch, torch.float64, job.config.train.table(model))
    if not lowering(operator) and epoch is None:
        job.progress.note(f"evaluate: {model} is evaluated by torch, for it has no fused form")
    if job.device == "cpu" and lowering(operator):
        return Fused(job.plant, operator, job.config.evaluate.nx, name, precision=np.float64)
    return Neural(job.plant, operator, job.config.evaluate.nx, job.device, name)


def on_any_grid(job: Job, network: Predictor) -> Predictor:
    """The same network by torch, equal up to rounding: on the data's grid it need not be compiled once more."""
    from npred.predictors.neural import Neural

    operator = getattr(network, "operator")  # noqa: B009 - every predictor of this module has one
    return Neural(job.plant, operator, network.nx, job.device, network.name)
