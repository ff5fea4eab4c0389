"""Why a guard falls back in hostile loops: in how many of these calls the network is wrong.

    python benchmarks/doubts.py [MODEL] [--nx 51] [--loops 16] [--t-end 40] [--tolerance 0.01] [--only nominal noise]

MODEL is pipeline/paper.toml:deeponet by default, and has to be trained. The loops are those of benchmarks/hostile.py.
Of the calls that fell back, CALLS at random are judged by what benchmarks/guard_adversary.py takes for the truth: RK4
of its own on 16 steps a cell, the error by the nearest of three readings of u. `wrong` are those whose error is above
the tolerance, `outside` those beyond the data, `read` those where the readings differ by more than the tolerance in U.
"""

import argparse
from pathlib import Path

import numpy as np
from guard_adversary import FINE, SYSTEMS, Calls, by_rk4, command, gap
from hostile import NX, conditions

import npred
from npred.guard.guarded import Guarded
from npred.lab import config
from npred.prediction.methods import Predictor

CALLS = 3000
HEAD = ["class", "fallback", "wrong", "outside", "read", "median error", "median estimate"]


class Watched(Predictor):
    """A guarded predictor that keeps the calls which fell back."""

    def __init__(self, guarded: Guarded) -> None:
        super().__init__(guarded.plant, guarded.nx)
        self.guarded, self.steps, self.kept = guarded, 0, []
        self.name = guarded.name  # type: ignore[misc]

    def predict(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray | float) -> np.ndarray:
        t = np.broadcast_to(np.asarray(t, dtype=float), len(X))
        finite = np.isfinite(X).all(axis=1) & np.isfinite(u).all(axis=(1, 2))
        P, rows = np.full((len(X), self.nx, self.plant.n), np.nan), [a[finite] for a in (X, u, D_hat, t)]
        P_hat = self.guarded.model(*rows)
        fallback = self.guarded.judge(P_hat, *rows)[1]
        P[finite] = P_hat
        if fallback.any():
            calls = [np.array(a[fallback]) for a in rows]
            P[np.flatnonzero(finite)[fallback]] = self.guarded.exact(*calls)
            self.kept.append(calls)
        self.steps += len(X)
        return P


@np.errstate(all="ignore")
def reasons(guarded: Guarded, calls: Calls) -> list[str]:
    """The shares of calls that are wrong, outside and read in several ways, and the medians of error and estimate."""
    P = guarded.model(*calls)
    exact = by_rk4(SYSTEMS[guarded.plant.name], calls, FINE)
    error = np.nan_to_num(gap(command(guarded, P, calls), exact), nan=np.inf)
    apart = np.abs(exact - exact[:1]).max(axis=(0, 1)) > guarded.tolerance
    shares = [(error > guarded.tolerance).mean(), (guarded.beyond(*calls) > 1).mean(), apart.mean()]
    medians = [np.median(error), np.median(guarded.judge(P, *calls)[0])]
    return [*(f"{share:.0%}" for share in shares), *(f"{value:.2g}" for value in medians)]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("model", nargs="?", default="pipeline/paper.toml:deeponet")
    parser.add_argument("--store", default="artifacts")
    parser.add_argument("--nx", type=int, default=NX)
    parser.add_argument("--loops", type=int, default=16)
    parser.add_argument("--only", nargs="*", default=[""], help="classes whose names have one of these words")
    for name, default in (("t-end", 40.0), ("tolerance", 0.01)):
        parser.add_argument(f"--{name}", type=float, default=default)
    options = parser.parse_args()
    pipeline = config.load(Path(options.model.rsplit(":", 1)[0]))
    network = npred.load(options.model, nx=options.nx, runtime="fused", store=options.store)
    guarded, rng = Guarded(network, options.tolerance), np.random.default_rng(0)
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    for name, condition in conditions(network.plant, pipeline, options.loops, options.t_end).items():
        if not any(word in name for word in options.only):
            continue
        watched = Watched(guarded)
        condition.loops(network.plant, watched, every=10**6, progress=False)
        kept = [np.concatenate(parts) for parts in zip(*watched.kept, strict=True)]
        count = len(kept[0]) if kept else 0
        chosen = rng.permutation(count)[:CALLS]
        cells = reasons(guarded, Calls(*(a[chosen] for a in kept))) if count else ["–"] * 5
        print(f"| {name} | {count / watched.steps:.2%} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
