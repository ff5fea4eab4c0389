"""Grids of pipelines as one graph of stages: its cells, its scheduler, its table and its front."""

from npred.sweep.scheduler import Progress, Sweep
from npred.sweep.sweep_grid import Cell, cells

__all__ = ["Cell", "Progress", "Sweep", "cells"]
