"""Delay models: the prediction problem of each kind of plant and delay, one file each behind one interface."""

from npred.plants.base import Plant
from npred.prediction.delays.arrays import ArrayProblem
from npred.prediction.delays.constant import ConstantDelay
from npred.prediction.delays.declared import DeclaredDelay
from npred.prediction.delays.per_input import DelayPerInput
from npred.prediction.delays.problem import PredictionProblem

PROBLEMS: tuple[type[PredictionProblem], ...] = (ArrayProblem, ConstantDelay, DeclaredDelay, DelayPerInput)


def problem_of(plant: Plant) -> PredictionProblem:
    """The kernels of a plant, by its kind and that of its delay."""
    return next(kind(plant) for kind in PROBLEMS if kind.serves(plant))
