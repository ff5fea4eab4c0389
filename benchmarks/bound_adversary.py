"""What an adversary finds of the bound of npred_experiments.bounds: calls whose true error of U is above it.

    python benchmarks/bound_adversary.py [MODEL] [--nx 51] [--states box|data] [--calls 60_000] [--store artifacts]

Populations by CMA-ES, those of guard_adversary.py, maximise the true error over the bound. The bound is that of inputs
read by the means of half cells, so the true error is of that reading: by RK4 on 4 steps a cell of formulas written
anew. The calls that come nearest to the bound are integrated by SciPy's DOP853, rtol 1e-12, whose figure counts. Errors
below `TINY` are left out: they are those of the integrations. Printed is one row of a Markdown table.
"""

import argparse
from pathlib import Path

import harness
import numpy as np
from guard_adversary import READINGS, SIZE, SYSTEMS, Calls, Population, Ranges, System, by_dop853, by_rk4, most

import npred
from npred.guard.guarded import Guarded
from npred_experiments.bounds import ErrorBound

TOGETHER, GENERATIONS = 20, 50  # populations side by side
STEPS = 4  # of RK4 a cell: to search by
TINY = 1e-7  # of an error of U: smaller ones are not told from those of the integrations
NEAREST = 20  # calls that DOP853 integrates
HEAD = ["network, nodes", "where X", "calls", "bounded", "largest error / bound, RK4", "the same, DOP853"]
MEANS = READINGS.index("means")


@np.errstate(all="ignore")
def ratios(guard: Guarded, error_bound: ErrorBound, system: System, calls: Calls) -> tuple[np.ndarray, ...]:
    """Of each call the true error over the bound (0 where it is tiny), the bound, and U of the network."""
    P = guard.model(*calls)
    U = guard.plant.kappa(P[:, -1], calls.t + calls.D_hat).T
    bound = error_bound(P, *calls)
    error = np.abs(U - by_rk4(system, calls, STEPS)[MEANS]).max(axis=0)
    ratio = np.where(np.isfinite(bound) & np.isfinite(error) & (error > TINY), error / bound, 0.0)
    return ratio, bound, U


def search(
    guard: Guarded, error_bound: ErrorBound, system: System, ranges: Ranges, starts: np.ndarray,
    options: argparse.Namespace,
) -> tuple[int, int, np.ndarray]:  # fmt: skip
    """How many calls were made and bounded, and the rows z, ratio of those nearest to the bound."""
    rng, made, bounded = np.random.default_rng(options.seed), 0, 0
    nearest = np.zeros((0, starts.shape[1] + 1))
    while made < options.calls:
        populations = [Population(starts[k].copy(), ranges, rng) for k in rng.integers(len(starts), size=TOGETHER)]
        for _ in range(GENERATIONS):
            z = np.concatenate([population.ask() for population in populations])
            ratio, bound, _ = ratios(guard, error_bound, system, ranges.calls(z))
            # of a call without a bound: the smaller D_hat, the nearer to one that has it
            score = np.where(np.isfinite(bound), np.log(np.maximum(ratio, 1e-9)), -30.0 - 10 * z[:, ranges.end])
            for population, scores in zip(populations, score.reshape(-1, SIZE), strict=True):
                population.tell(scores)
            made, bounded = made + len(z), bounded + int(np.isfinite(bound).sum())
            nearest = most(nearest, np.column_stack([z, ratio]), -1, NEAREST)
    return made, bounded, nearest


if __name__ == "__main__":
    options = harness.options(
        __doc__, {"model": harness.PAPER}, nx=51, calls=60_000, seed=1, states=("box", "data"), store=Path("artifacts")
    )
    guard, data = npred.guarded(harness.network(options)), harness.samples(options.model, options.store)
    system, ranges = SYSTEMS[guard.plant.name], Ranges(guard, data, options.states)
    starts = ranges.starts(np.random.default_rng(options.seed), data, 2000)
    error_bound = ErrorBound.of(guard)
    made, bounded, nearest = search(guard, error_bound, system, ranges, starts, options)
    calls = ranges.calls(nearest[:, :-1])
    _, bound, U = ratios(guard, error_bound, system, calls)
    exact = np.array([by_dop853(system, *(part[k] for part in calls))[MEANS] for k in range(len(nearest))])
    ratio = np.abs(U.T - exact).max(axis=1) / bound
    found = made, bounded, f"{nearest[0, -1]:.9f}", f"{ratio.max():.9f}"
    harness.head(*HEAD)
    harness.row(f"`{Path(options.model).name}`, {options.nx}", options.states, *found)
