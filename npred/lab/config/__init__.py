"""The pipeline file as frozen models: one table per stage, every key checked, `--set` overrides included."""

from npred.base.registry import FROZEN, PAPER
from npred.lab.config.evaluate import Evaluate, GuardTable, Scenario
from npred.lab.config.file import dumps, load, override, parse, put, table, value
from npred.lab.config.loop import Disturbance, LoopTable, ObserverTable
from npred.lab.config.pipeline import Bench, Generate, Pipeline, Tune
from npred.lab.config.section import Anchor, Range, Section
from npred.lab.config.train import FNO, DeepONet, Network, Train, Training

__all__ = [
    "FNO", "FROZEN", "PAPER", "Anchor", "Bench", "DeepONet", "Disturbance", "Evaluate", "Generate",
    "GuardTable", "LoopTable", "Network", "ObserverTable", "Pipeline", "Range", "Scenario", "Section",
    "Train", "Training", "Tune", "dumps", "load", "override", "parse", "put", "table", "value",
]  # fmt: skip
