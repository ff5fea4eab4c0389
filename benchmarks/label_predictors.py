"""Which numerical predictor a pipeline's data should be made by: its error and its time, and that of the data.

python benchmarks/label_predictors.py pipeline/geared_arm.toml --rollouts 4

Rows of a few rollouts of the pipeline are predicted by each method on the nodes of the data, and compared with RK4 on
four times as many intervals: the largest error of rows before the first delay, where u jumps, of those after it, and
the median of all (each the largest over nodes). Then the same few rollouts are made with each method in turn. Times are
of the processor.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from npred import plants
from npred.base import grid
from npred.base.registry import METHODS
from npred.lab import config
from npred.lab.stages.generate import sampling
from npred.prediction.delays import problem_of
from npred.prediction.methods import OneStep, Predictor, method

FINER = 4


def seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    """Processor seconds of a call, and what it returns."""
    begin = time.process_time()
    answer = function()
    return time.process_time() - begin, answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pipeline", type=Path)
    parser.add_argument("--rollouts", type=int, default=4)
    arguments = parser.parse_args()
    pipeline = config.load(arguments.pipeline)
    plant, table, count = plants.resolve(pipeline.plant, pipeline.parameters), pipeline.generate, arguments.rollouts
    few = table.model_copy(update={"rollouts": count, "samples": count * table.samples // table.rollouts})
    refusal = problem_of(plant).refusal
    kinds = [name for name in METHODS.names() if issubclass(method(name), OneStep) and not refusal(name)]

    def made(name: str) -> sampling.Columns:
        changed = few.model_copy(update={"predictor": name})
        return sampling.rows(pipeline.model_copy(update={"generate": changed}), plant, range(count), finite=False)

    rows = made(table.predictor)
    X, u, D_hat, t = (rows[key] for key in ("X", "u", "D_hat", "t"))
    fine = FINER * (table.nx - 1) + 1
    exact = grid.refine(method("rk4")(plant, fine)(X, grid.means(u, fine), D_hat, t), table.nx)
    early = t <= rows["D"]
    print(f"{len(X)} rows on {table.nx} nodes, {early.sum()} of them before the first delay")
    for name in kinds:
        run: Predictor = method(name)(plant, table.nx)
        with np.errstate(all="ignore"):
            run(X[:1], u[:1], D_hat[:1], t[:1])  # compiles
            taken, P = seconds(lambda: run(X, u, D_hat, t))  # noqa: B023 - called at once
            errors = np.nan_to_num(np.linalg.norm(P - exact, axis=-1).max(axis=1), nan=np.inf)
            made(name)
            data, _ = seconds(lambda: made(name))  # noqa: B023
        print(f"  {name:14} before {errors[early].max(initial=0.0):.1e}, after {errors[~early].max():.1e}, "
              f"median {np.median(errors):.1e}; {1e6 * taken / len(X):.0f} µs per row; the data {data:.2f} s",
              flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
