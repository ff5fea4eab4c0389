"""Observers of a state that is not measured, from what is: one file each behind one interface, npred.observers.base."""

from npred.docstrings import documented
from npred.observers.base import Observer as Observer
from npred.observers.ekf import EKF as EKF
from npred.observers.luenberger import Luenberger as Luenberger

for public in (EKF, Luenberger):
    documented(public)
