"""Observers of the state from measured outputs: one file each behind one interface, that of `base`."""

from npred.estimation.observers.base import Observer as Observer
from npred.estimation.observers.ekf import EKF as EKF
from npred.estimation.observers.luenberger import Luenberger as Luenberger
