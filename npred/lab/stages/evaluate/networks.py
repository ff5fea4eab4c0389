"""Networks as an evaluation runs them: compiled where that is possible."""

import numpy as np

from npred.lab.config.results import PredictorId
from npred.lab.scheduler.job import Job
from npred.prediction.methods import Predictor


def load(job: Job, contender: PredictorId) -> Predictor:
    """The fused network, as it is deployed but in double precision: in float32 an FNO's loops end 3e-6 away.

    A network that cannot be lowered is evaluated by torch.
    """
    from npred import networks as runtimes
    from npred.networks.fused import Fused, lowering
    from npred.networks.weights import read

    model, epoch, name = contender.model, contender.epoch, contender.name
    operator = read(job.inputs[model], job.plant, epoch, np.float64, job.config.train.table(model))
    if not lowering(operator) and epoch is None:
        job.progress.note(f"evaluate: {model} is evaluated by torch, for it has no fused form")
    if job.device == "cpu" and lowering(operator):
        return Fused(job.plant, operator, job.config.evaluate.nx, name, precision=np.float64)
    return runtimes.predictor("torch", job.plant, operator, job.config.evaluate.nx, name, job.device)


def on_any_grid(job: Job, network: Predictor) -> Predictor:
    """The same network, equal up to rounding: by torch, where it is installed, for then the data's grid need not be
    compiled too.
    """
    from npred import networks as runtimes

    operator = getattr(network, "operator")  # noqa: B009 - every predictor of this module has one
    return runtimes.predictor(None, job.plant, operator, network.nx, network.name, job.device)
