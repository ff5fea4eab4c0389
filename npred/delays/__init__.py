"""Delay models: each kind of plant and delay is a family of kernels, one file behind one interface."""

from npred.delays.arrays import ArrayFamily
from npred.delays.constant import ConstantDelay
from npred.delays.declared import DeclaredDelay
from npred.delays.family import Family
from npred.delays.per_input import DelayPerInput
from npred.plants.base import Plant

FAMILIES: tuple[type[Family], ...] = (ArrayFamily, ConstantDelay, DeclaredDelay, DelayPerInput)


def family_of(plant: Plant) -> Family:
    """The kernels of a plant, by its kind and that of its delay."""
    return next(family(plant) for family in FAMILIES if family.serves(plant))
