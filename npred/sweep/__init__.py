"""Grids of pipelines: the cells, the table of their results and its front."""

from npred.sweep.sweep_grid import Cell, cells

__all__ = ["Cell", "cells"]
