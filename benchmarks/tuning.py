"""What `npred tune` gains on four pipelines, beside the best of a grid over the same ranges.

    python benchmarks/tuning.py [NAME …] [--cells 12] [--evaluations 150] [--jobs 1]

The grid has its cells on the logarithmic scale, ends included, is judged on the same training starts, and its best on
the same held-out starts. Loops are shorter than the pipelines', for they settle long before. Markdown goes to stdout.
"""

from itertools import product
from pathlib import Path

import harness
import numpy as np

from npred import plants
from npred.base import progress
from npred.lab import config
from npred.lab.config import Tune
from npred.lab.stages.tuning import Loops, Yardstick, compared, said, tune

SETS = {  # pipeline: what is set in it
    "paper": ["evaluate.t_end=40.0", "evaluate.case_t_end=40.0"],
    "chemostat": ["evaluate.t_end=30.0", "evaluate.case_t_end=30.0"],
    "van_der_pol": ['tune.free=["k1", "k2"]', "tune.bounds={ k1 = [1.0, 20.0], k2 = [1.0, 20.0] }"],
    "cart_pole": [
        'kappa="lqr"', 'tune.free=["Q.p", "R.F"]', 'evaluate.adaptation="frozen"', "evaluate.case_D_hat=[0.2]",
        "evaluate.t_end=20.0", "evaluate.case_t_end=20.0",
    ],
}  # fmt: skip
HEAD = ("pipeline", "", "numbers", "cost, training", "cost, held-out", "gain, held-out", "tries")


def rows(name: str, cells: int, evaluations: int, jobs: int) -> list[tuple[str, ...]]:
    """A pipeline before, by CMA-ES, and by the grid."""
    sets = [*SETS[name], f"tune.evaluations={evaluations}"]
    pipeline = config.load(Path(__file__).parents[1] / "pipeline" / f"{name}.toml", sets)
    plant, table = plants.resolve(pipeline.plant, pipeline.parameters, pipeline.kappa), pipeline.tune or Tune()
    result = tune(pipeline, plant, jobs)
    before = {each.name: each.before for each in result.numbers}
    axes = [np.geomspace(each.low, each.high, cells).tolist() for each in result.numbers]
    training = Loops(pipeline, plant, table.starts, "training")
    held_out = Loops(pipeline, plant, table.held_out, "held out")
    yardstick = Yardstick.of(training.run(before, _silent), table.effort, pipeline.evaluate.dt)
    grid = [dict(zip(before, values, strict=True)) for values in product(*axes)]
    costs = [float(yardstick.costs(training.run(numbers, _silent)).mean()) for numbers in grid]
    best = grid[int(np.argmin(costs))]
    judged_before, judged = (yardstick.costs(held_out.run(numbers, _silent)) for numbers in (before, best))
    by_grid = compared(judged_before, judged, np.random.default_rng(0))
    training_cost, held_out_cost = result.training.cost, result.held_out.cost
    return [
        (name, "before", said(before), f"{training_cost.before:.3f}", f"{held_out_cost.before:.3f}", "", ""),
        ("", "CMA-ES", said({n.name: n.after for n in result.numbers}), f"{training_cost.after:.3f}",
         f"{held_out_cost.after:.3f}", held_out_cost.change(), str(result.evaluations)),
        ("", "grid", said(best), f"{min(costs):.3f}", f"{judged.mean():.3f}", by_grid.change(), str(len(grid))),
    ]  # fmt: skip


def _silent(steps: int) -> None:
    pass


if __name__ == "__main__":
    asked = harness.options(__doc__, {"names": [*SETS]}, cells=12, evaluations=150, jobs=1)
    harness.head(*HEAD)
    with progress.quiet():
        for name in asked.names:
            for row in rows(name, asked.cells, asked.evaluations, asked.jobs):
                harness.row(*row)
