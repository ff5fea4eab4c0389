"""Closed loops under stated conditions: starts, delays, sensors, parameters and disturbances, of every stage alike."""

from npred.lab.config.conditions.condition import EVERY, Condition, compiled
from npred.lab.config.conditions.starts import Starts, box, starts

__all__ = ["EVERY", "Condition", "Starts", "box", "compiled", "starts"]
