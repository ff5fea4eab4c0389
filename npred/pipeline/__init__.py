"""The runner: key, hit or run, store; and the reason of every run."""

from npred.pipeline.cells import Cell, cells
from npred.pipeline.models import Stored, load_data, load_model
from npred.pipeline.plan import Planner, Step
from npred.pipeline.reach import Kept, closure
from npred.pipeline.runner import Outcome, Runner
from npred.pipeline.sweep import Progress, Sweep
from npred.pipeline.table import STAGES, Node, Stage, networks, nodes

__all__ = [
    "STAGES",
    "Cell",
    "Kept",
    "Node",
    "Outcome",
    "Planner",
    "Progress",
    "Runner",
    "Stage",
    "Step",
    "Stored",
    "Sweep",
    "cells",
    "closure",
    "load_data",
    "load_model",
    "networks",
    "nodes",
]
