"""A training step, plain and as the recipe takes it: milliseconds, on one thread.

    python benchmarks/training_step.py

Plain is the loss on every node of the data, and the point of rest evaluated for each row. The recipe takes the loss on
the nodes that pipeline/paper.toml names (u is seen on all) and interpolates the term at rest in D_hat.
"""

import time
from pathlib import Path

import numpy as np
import torch

import npred
from npred.lab import config
from npred.lab.training import operators
from npred.lab.training.operators import Scaling
from npred.lab.training.rows import REST_NODES
from npred.lab.training.training_loop import optimiser_of

NX, STEPS = 101, 20


def milliseconds(plant, table, rest_nodes: int | None, nodes: int) -> float:
    """The median of a step: forward, backward and the optimiser."""
    torch.manual_seed(0)
    operator = operators.build(table, plant, Scaling(plant.n, plant.m))
    optimiser = optimiser_of(operator, table)
    X, u = torch.randn(table.batch, plant.n), torch.randn(table.batch, NX, plant.m)
    D_hat, stride = torch.rand(table.batch) + 0.5, (NX - 1) // (nodes - 1)
    P, times = torch.randn(table.batch, nodes, plant.n), []
    for _ in range(STEPS):
        start = time.perf_counter()
        loss = ((operator(X, u, D_hat, rest_nodes=rest_nodes, stride=stride) - P) ** 2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        times.append(1000 * (time.perf_counter() - start))
    return float(np.median(times))


if __name__ == "__main__":
    torch.set_num_threads(1)
    pipeline = config.load(Path("pipeline/paper.toml"))
    plant = npred.plant(pipeline.plant)
    for name in ("deeponet", "fno"):
        table = getattr(pipeline.train, name)
        plain = milliseconds(plant, table, None, NX)
        recipe = milliseconds(plant, table, REST_NODES, table.nodes)
        times = f"plain {plain:7.1f} ms   recipe {recipe:7.1f} ms   {plain / recipe:.1f}x"
        print(f"{name:10s}{table.batch:6d} rows   {times}")
