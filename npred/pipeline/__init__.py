"""The scheduler: key, hit or run, store; and the reason of every run."""

from npred.pipeline.models import Stored, load_data, load_model
from npred.pipeline.plan import Node, Step
from npred.pipeline.retention import Kept, closure, remember
from npred.pipeline.runner import CellRun, Runner
from npred.pipeline.stage_registry import STAGES, Planner, nodes, usual
from npred.pipeline.task import Outcome

__all__ = [
    "STAGES", "CellRun", "Kept", "Node", "Outcome", "Planner", "Runner", "Step", "Stored", "closure", "load_data",
    "load_model", "nodes", "remember", "usual",
]  # fmt: skip
