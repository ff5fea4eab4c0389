"""What hostile loops make of a network, bare and guarded: 64 loops a class, 100 s (about three minutes a network).

    python benchmarks/hostile.py [MODEL] [STORE] [--loops 16] [--t-end 40] [--tolerance 0.05] [--lost 2]
        [--nx 51] [--only nominal noise] [--doubts]

MODEL is pipeline/paper.toml:deeponet by default, and has to be trained. A loop is lost that ends further from rest than
`--lost` times |X*|; "extra" are those that the numerical predictor keeps. Times are shares of the length of a loop, and
delays multiples of the pipeline's D where its plant knows its delay; the estimate then stays where it starts.

--doubts: in how many of the calls that fell back the network is wrong. CALLS of a class at random are judged by what
benchmarks/guard_adversary.py takes for the truth: RK4 of its own on 16 steps a cell, the error by the nearest of its
readings of u. `wrong` are those whose error is above the tolerance, `outside` those beyond the data, `read` those where
the readings differ by more than the tolerance in U.
"""

from collections.abc import Callable
from dataclasses import replace

import harness
import numpy as np
from guard_adversary import FINE, SYSTEMS, Calls, by_rk4, command, gap

import npred
from npred import metrics
from npred.guard.guarded import Guarded
from npred.lab import config
from npred.lab.config import FROZEN, Evaluate, Scenario
from npred.lab.config.conditions import EVERY, Condition, box, true_delay
from npred.lab.config.evaluate import Jump
from npred.loop.measurement import Sensors
from npred.plants import Plant
from npred.prediction.methods import Predictor

CALLS = 3000
LOST = ["numerical: lost, peak", "bare: extra, peak", "guarded: extra, peak, fallback"]
DOUBTS = ["fallback", "wrong", "outside", "read", "median error", "median estimate"]


def pulse(size: float, at: float) -> Callable[[float], float]:
    """A disturbance at the input for one second."""
    return lambda t: size if at <= t < at + 1 else 0.0


def conditions(plant: Plant, pipeline: config.Pipeline, loops: int, t_end: float) -> dict[str, Condition]:
    """The conditions by what is hostile in them."""
    rng, ranges = np.random.default_rng(0), box(plant, pipeline.generate)
    frozen = pipeline.evaluate.adaptation == FROZEN
    X0 = rng.uniform(ranges[:, 0], ranges[:, 1], (loops, plant.n))
    middle, positive = ranges.mean(axis=1), ranges[:, 0] > 0
    wide = middle + 5 * (X0 - middle)
    table = pipeline.evaluate if frozen else Evaluate()
    D, at = table.D, 0.2 * t_end
    wrong = {round(step * t_end / 100 * 0.005 / table.dt) for step in rng.integers(1000, 8000, 5)}

    def flipped(X_hat: np.ndarray, Y: np.ndarray, U: np.ndarray, t: float) -> np.ndarray:
        return -Y if round(t / table.dt) in wrong else Y

    def noisy(share: float) -> Evaluate:
        return table.model_copy(update={"measurement": Sensors(relative_noise=share)})

    near = np.array(pipeline.generate.D_hat, dtype=float) if frozen else np.array([0.3, 2.5])
    nominal = Condition(table, X0, D, rng.uniform(near.min(), near.max(), loops), t_end, seed=0)
    slow, faster = table.model_copy(update={"D": 2 * D}), Scenario(name="faster", jump=Jump(at=at, to=D / 4))
    return {
        "nominal": nominal,
        "starts from a box 5 times as wide": replace(nominal, X0=np.where(positive, np.abs(wide), wide)),
        **{f"noise {share:.0%}": replace(nominal, table=noisy(share)) for share in (0.03, 0.05)},
        **{f"D̂(0) = {share:g} D": replace(nominal, D_hat=share * D) for share in (0.1, 4.0)},
        "D from 2 D to D / 4": replace(nominal, table=slow, D=true_delay(slow, faster)),
        **{f"pulse of U {size:+g}": replace(nominal, disturbance=pulse(size, at)) for size in (0.5, -0.5, 1.0, -1.0)},
        "five samples of X with the sign turned": replace(nominal, observer=flipped),
    }


def outcome(plant: Plant, predictor: Predictor, condition: Condition, far: float) -> tuple[np.ndarray, float, float]:
    """Which loops are lost, the largest distance from rest, and the share of steps with the numerical predictor."""
    loops = condition.loops(plant, predictor, every=EVERY)
    target = plant.target(loops.t)
    lost = metrics.far(loops, target, far)
    return lost, float(np.nan_to_num(np.linalg.norm(loops.X - target, axis=-1), nan=np.inf).max()), loops.fallback_share


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


def doubts(guarded: Guarded, condition: Condition, rng: np.random.Generator) -> list[str]:
    """What is told of the calls that fell back in a class."""
    watched = Watched(guarded)
    condition.loops(guarded.plant, watched, every=10**6, progress=False)
    kept = [np.concatenate(parts) for parts in zip(*watched.kept, strict=True)]
    count = len(kept[0]) if kept else 0
    chosen = rng.permutation(count)[:CALLS]
    cells = reasons(guarded, Calls(*(a[chosen] for a in kept))) if count else ["–"] * 5
    return [f"{count / watched.steps:.2%}", *cells]


def compared(guarded: Guarded, condition: Condition, far: float) -> list[str]:
    """A class by the numerical predictor, and by the network, bare and guarded."""
    runs = npred.predictor(guarded.plant, "rk4", guarded.nx), guarded.model, guarded
    (lost, peak, _), bare, safe = (outcome(guarded.plant, run, condition, far) for run in runs)
    extra = [int((each[0] & ~lost).sum()) for each in (bare, safe)]
    return [f"{lost.sum()}, {peak:.3g}", f"{extra[0]}, {bare[1]:.3g}", f"{extra[1]}, {safe[1]:.3g}, {safe[2]:.2%}"]


if __name__ == "__main__":
    places = {"model": harness.PAPER, "store": "artifacts"}
    named = {"loops": 64, "nx": 51, "only": [""], "t_end": 100.0, "tolerance": 0.01, "lost": metrics.FAR}
    options = harness.options(__doc__, places, doubts=False, **named)
    pipeline, guarded = harness.pipeline(options.model), Guarded(harness.network(options), options.tolerance)
    name, counts = guarded.reference
    print(f"guarded by shadows, {name} on {', '.join(map(str, counts))} steps, tolerance {guarded.tolerance:g}")
    rng, loops = (
        np.random.default_rng(0),
        ("numerical: lost, peak", "bare: extra, peak", "guarded: extra, peak, fallback"),
    )
    harness.head("class", *(DOUBTS if options.doubts else loops))
    for name, condition in conditions(guarded.plant, pipeline, options.loops, options.t_end).items():
        if any(word in name for word in options.only):
            told = doubts(guarded, condition, rng) if options.doubts else compared(guarded, condition, options.lost)
            harness.row(name, *told)
