"""What a guard costs: one call of a trained network, bare and guarded, beside numerical methods of its accuracy.

python benchmarks/guard_cost.py pipeline/geared_arm.toml:deeponet --tolerance 1 --nx 401 101
python benchmarks/guard_cost.py pipeline/paper.toml:deeponet --tolerance 0.01 --nx 101

Calls are of one lane on held-out samples after the first delay, as a compiled loop makes them; times are medians in
microseconds, all contenders in turn. `doubted` is the share of held-out samples, before and after the first delay, that
the numerical predictor answers. benchmarks/starts.py counts the loops that are lost.
"""

from collections.abc import Callable
from pathlib import Path

import harness
import numpy as np

import npred
from npred.base import grid
from npred.base.registry import METHODS
from npred.guard.guarded import Guarded
from npred.kernels import kernel
from npred.lab.scheduler.models import load_model
from npred.lab.stages.bench import candidates, timing
from npred.loop import metrics
from npred.prediction.delays import problem
from npred.prediction.methods import OneStep, Predictor, method

PROBES = 64
NEAR = 0.3, 3.0  # of the tolerance: where the estimate decides


def one_call(run: Predictor) -> kernel.Kernel:
    """The compiled call of a loop: the model, and its guard where there is one."""
    parts = {"MODEL": run.lanes()} | ({"CHECK": run.guard} if isinstance(run, Guarded) else {})
    check = "    CHECK(d, X, u, D_hat, t, p, guard, P, error, fallback, work);\n" if len(parts) > 1 else ""
    head = kernel.prototype("KERNEL", problem.GUARD)
    body = f"static inline {head}\n{{\n    MODEL(d, X, u, D_hat, t, p, P, work);\n{check}}}\n"

    def work(nx: int, lanes: int, settings: np.ndarray) -> int:
        return max(part.work(nx, lanes, settings) for part in parts.values())

    return kernel.made("call", problem.GUARD, body, {}, {}, parts, work=work)


def calls(runs: dict[str, Predictor], reference: candidates.Reference) -> dict[str, float]:
    """Medians in microseconds."""

    def caller(run: Predictor) -> Callable[[int], None]:
        call, u = one_call(run), grid.means(reference.u[:PROBES], run.nx)
        settings = run.settings if isinstance(run, Guarded) else np.zeros(7)
        P, error, fallback = np.empty((run.nx, run.plant.n, 1)), np.empty(1), np.empty(1)
        rows = zip(reference.X[:PROBES, :, None], u[..., None], reference.D_hat[:PROBES, None], strict=True)
        inputs = [[np.ascontiguousarray(a) for a in row] for row in rows]
        bound = [call.bound(*row, 0.0, run.plant.p, settings, P, error, fallback) for row in inputs]
        return lambda k: bound[k % len(bound)]()

    taken = timing.sample({name: caller(run) for name, run in runs.items()}, 5000, 2.0)
    return {name: timing.quantiles(times)["median_us"] for name, times in taken.items()}


def estimates(guard: Guarded, data) -> None:
    """How often the guard doubts on held-out samples, and its estimate over the true error where that decides."""
    X, u, D_hat, t = data.X, grid.means(data.u, guard.nx), data.D_hat, data.t
    exact = npred.predictor(guard.plant, "rk4", data.u.shape[1])(X, data.u, D_hat, t)[:, -1:]
    P_hat = guard.model(X, u, D_hat, t)
    true = np.abs(metrics.law(guard.plant, P_hat[:, -1:], t, D_hat) - metrics.law(guard.plant, exact, t, D_hat))
    true = true.max(axis=-1)
    estimate, fallback = guard.judge(P_hat, X, u, D_hat, t)
    near = (true > NEAR[0] * guard.tolerance) & (true < NEAR[1] * guard.tolerance)
    ratio = np.quantile(estimate[near] / true[near], (0.01, 0.5, 0.99)) if near.any() else np.full(3, np.nan)
    early = t <= data.D
    shares = [f"{fallback[rows].mean():.1%}" if rows.any() else "-" for rows in (early, ~early)]
    unnoticed = (~fallback & (true > guard.tolerance)).sum()
    print(f"  doubted {shares[0]} before the first delay, {shares[1]} after; unnoticed {unnoticed}")
    quantiles = f"1 % {ratio[0]:.2f}, median {ratio[1]:.2f}, 99 % {ratio[2]:.2f}"
    print(f"  estimate over true error, {near.sum()} calls: {quantiles}")


if __name__ == "__main__":
    arguments = harness.options(__doc__, {"model": ...}, store=Path, tolerance=0.01, nx=[101])
    stored = load_model(arguments.model, arguments.store)
    data = harness.samples(arguments.model, arguments.store).subset(test=True)
    reference = candidates.Reference.of(stored.plant, data)
    rivals = [k for k in map(method, METHODS.names()) if issubclass(k, OneStep)]
    rivals = [kind for kind in rivals if not npred.prediction.delays.problem_of(stored.plant).refusal(kind.name)]
    for nx in arguments.nx:
        net = harness.network(arguments, nx)
        guard = Guarded(net, arguments.tolerance)
        eps = reference.errors(net, nx).sup
        runs: dict[str, Predictor] = {"bare": net, "guarded": guard, "fallback": guard.exact}
        for kind in rivals:
            if nodes := candidates.matching(reference, kind, eps):
                runs[f"{kind.name} on {nodes - 1} steps"] = kind(stored.plant, nodes)
        times = calls(runs, reference)
        by, counts = guard.reference
        print(f"{stored.plant.name}, nx = {nx}, sup error {eps:.2g}, tolerance {arguments.tolerance:g}: "
              f"shadows by {by} on {', '.join(map(str, counts))} steps, falls back to {guard.exact.name}")  # fmt: skip
        for name, median in times.items():
            print(f"  {name}: {median:.1f} µs, {median / times['bare']:.2f} x bare")
        estimates(guard, data)
