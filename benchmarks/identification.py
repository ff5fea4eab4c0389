"""What `npred.identify` finds in simulated logs, beside three estimators re-implemented from their descriptions.

    python benchmarks/identification.py [logs] [two] [silent] [rivals] [time] [adversary] [--logs 200] [--each]

Prints Markdown tables. Errors and widths are in sampling periods, of every input's delay. `--each` prints every log.
"""

import argparse
import time
from collections.abc import Callable, Iterable
from typing import Any

import cma
import numpy as np
from delay_estimators import ESTIMATORS
from simulated_logs import KINDS, WHY, Sample, excited, silent

from npred import plants
from npred.base.errors import ConfigError
from npred.identification.identify import identify

MAIN = [name for name in KINDS if name != "mixer"]
PLANTS = {name: plants.make(kind.declaration.__name__, kind.declaration) for name, kind in KINDS.items()}
RIVALS_LONGEST = 50  # periods
Answer = tuple[np.ndarray, np.ndarray, np.ndarray, float]  # D (m,), interval (m, 2), told (m,), seconds


def ours(log: Sample) -> Answer:
    """`npred.identify`'s answer."""
    begin = time.perf_counter()
    r = identify(PLANTS[log.kind], log.t, log.U, log.X, longest=log.about.get("longest"))
    return r.D, r.interval, r.identifiable, time.perf_counter() - begin


def rival(estimator: Callable[..., Any]) -> Callable[[Sample], Answer]:
    """An estimator's answer; it is told that the delay is at most twice the longest one of these logs."""

    def answer(log: Sample) -> Answer:
        begin, longest = time.perf_counter(), RIVALS_LONGEST * log.period
        found = [estimator(PLANTS[log.kind], log.t, log.U, log.X, j, longest) for j in range(log.U.shape[1])]
        D, low, high, told = (np.array(column) for column in zip(*found, strict=True))
        return D, np.stack([low, high], axis=1), told, time.perf_counter() - begin

    return answer


def main_logs(count: int) -> Iterable[Sample]:
    """The logs of the first table, always the same."""
    return (excited(MAIN[k % len(MAIN)], np.random.default_rng([18, k])) for k in range(count))


def inside(interval: np.ndarray, D: np.ndarray) -> np.ndarray:
    """(m,) True where the interval holds D."""
    return (interval[:, 0] <= D) & (interval[:, 1] >= D)


def table(logs: Iterable[Sample], answer: Callable[[Sample], Answer], each: bool) -> None:
    """One row by plant and one in all."""
    rows: dict[str, list[tuple[float, ...]]] = {}
    for k, log in enumerate(logs):
        D, interval, told, seconds = answer(log)
        error, width = (D - log.D) / log.period, np.diff(interval, axis=1)[:, 0] / log.period
        held = inside(interval, log.D)
        rows.setdefault(log.kind, []).extend(
            zip(abs(error), held, width, told, [seconds / len(D)] * len(D), strict=True)
        )
        if each:
            about = {name: v for name, v in log.about.items() if name != "delays"}
            print(k, log.kind, np.round(log.D / log.period, 2), error.round(2), width.round(2), held, told,
                  f"{seconds:.1f}", about, flush=True)  # fmt: skip
    print("| plant | delays | median error | 95 % of errors below | largest | intervals that hold D | median width "
          "| not identifiable | s a delay |\n" + "|---" * 9 + "|")  # fmt: skip
    for name, row in [*rows.items(), ("all", [v for values in rows.values() for v in values])]:
        error, held, width, told, seconds = np.array(row, dtype=float).T
        error = error[np.isfinite(error)]
        print(f"| {name} | {len(held)} | {np.median(error):.3f} | {np.quantile(error, 0.95):.2f} | {error.max():.2f} | "
              f"{held.mean():.1%} | {np.nanmedian(width):.2f} | {int((told == 0).sum())} | {seconds.mean():.2f} |",
              flush=True)  # fmt: skip


def unable(count: int, each: bool) -> None:
    """Logs that cannot tell: what is said of them, and whether the interval leaves room for the truth."""
    said, room = dict.fromkeys(WHY, 0), dict.fromkeys(WHY, 0)
    total = dict.fromkeys(WHY, 0)
    for k in range(count):
        log = silent(k, np.random.default_rng([33, k]))
        why = log.about["why"]
        try:
            D, interval, told, _ = ours(log)
        except ConfigError as error:  # refused in a sentence
            print(f"{k} {log.kind}, {why}: {error}")
            D, interval, told = log.D, np.stack([0 * log.D, log.D], axis=1), np.zeros(len(log.D), bool)
        truth = np.minimum(log.D, log.about["longest"] or np.inf)
        good = (interval[:, 0] <= truth + 1e-9) & (truth <= interval[:, 1] + 1e-6 * log.period)
        total[why], said[why], room[why] = total[why] + 1, said[why] + int(not told.any()), room[why] + int(good.all())
        if each or told.any() or not good.all():
            print(k, log.kind, why, "D", (log.D / log.period).round(2), "found", (D / log.period).round(2),
                  (interval / log.period).round(2).tolist(), told, "lag", (log.about.get("lag") or 0) / log.period,
                  flush=True)  # fmt: skip
    print("| why | logs | said not identifiable | interval leaves room for the truth |\n|---|---|---|---|")
    for why in (*WHY, "all"):
        values = [sum(d.values()) if why == "all" else d[why] for d in (total, said, room)]
        print(f"| {why} | " + " | ".join(map(str, values)) + " |", flush=True)


def timed() -> None:
    """Seconds for 1e5 rows and three free parameters."""
    for name, free in (("motor", ("R", "k", "J")), ("tank", ("area", "outflow")), ("mixer", ("k", "c"))):
        log = excited(name, np.random.default_rng(5), N=100_000, loop="open", noise=0.02)
        for attempt in ("first", "second"):  # the first one compiles
            begin, busy = time.perf_counter(), time.process_time()
            r = identify(PLANTS[name], log.t, log.U, log.X, free=free)
            print(f"{name}, 1e5 rows, free {', '.join(free)}, {attempt} call: {time.perf_counter() - begin:.1f} s "
                  f"({time.process_time() - busy:.1f} s of processor), error "
                  f"{((r.D - log.D) / log.period).round(3)} periods, {r.parameters}", flush=True)  # fmt: skip


def attacked(z: np.ndarray, name: str, seed: int, clean: bool) -> Sample:
    """The log of a point z in [0, 1]^9; `clean` has neither disturbances nor quantisation."""
    hold, amplitude, noise, jitter, delay, share, push, grid, rest = z
    m = len(KINDS[name].u)
    return excited(
        name, np.random.default_rng([99, seed]), N=400 + int(400 * rest), hold=float(3 * 40**hold),
        amplitude=0.1 + 0.9 * amplitude, noise=0.01 + 0.04 * noise, jitter=0.3 * jitter, off=0.03 * share,
        delays=np.full(m, 2 + 23 * delay), disturbance=0.0 if clean else 0.3 * push,
        resolution=0.0 if clean else 0.3 * grid,
        shape=("levels", "two", "sines")[seed % 3], loop=KINDS[name].loops[seed % len(KINDS[name].loops)],
    )  # fmt: skip


def adversary(name: str, seed: int, clean: bool, calls: int) -> None:
    """The log found by CMA-ES whose interval misses D by most of its widths, while the answer says identifiable."""
    worst: tuple[float, str] = (-np.inf, "nothing")
    missed = tried = 0

    def score(z: np.ndarray) -> float:
        nonlocal worst, missed, tried
        log = attacked(np.clip(z, 0, 1), name, seed, clean)
        _, interval, told, _ = ours(log)
        width = np.maximum(np.diff(interval, axis=1)[:, 0], 1e-3 * log.period)
        beyond = np.maximum(interval[:, 0] - log.D, log.D - interval[:, 1]) / width
        value = float(np.where(told, beyond, -0.5).max())
        tried, missed = tried + 1, missed + (value > 0)
        if value > worst[0]:
            about = {k: np.round(v, 3) if isinstance(v, float) else v for k, v in log.about.items() if k != "delays"}
            worst = value, (f"D {(log.D / log.period).round(2)}, interval {(interval / log.period).round(2).tolist()}, "
                            f"{about}")  # fmt: skip
        return -value

    search = cma.CMAEvolutionStrategy(
        np.full(9, 0.5), 0.3, {"bounds": [0, 1], "seed": seed + 1, "verbose": -9, "popsize": 10}
    )
    while tried < calls:
        points = search.ask()
        search.tell(points, [score(z) for z in points])
    logs = "clean" if clean else "disturbed, quantised"
    print(f"| {name} | {logs} | {tried} | {missed} | {worst[0]:.2f} | {worst[1]} |",
          flush=True)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="*", default=["logs", "two", "silent", "rivals", "time", "adversary"])
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--silent", type=int, default=50)
    parser.add_argument("--calls", type=int, default=100)
    parser.add_argument("--each", action="store_true")
    asked = parser.parse_args()
    if "logs" in asked.what:
        table(main_logs(asked.logs), ours, asked.each)
    if "two" in asked.what:
        pairs = ((name, k) for k in range(10) for name in ("planar_arm2", "mixer"))
        table((excited(name, np.random.default_rng([2, k])) for name, k in pairs), ours, asked.each)
    if "silent" in asked.what:
        unable(asked.silent, asked.each)
    for name, estimator in ESTIMATORS.items():
        if "rivals" in asked.what or name in asked.what:
            print(f"\n{name}")
            table(main_logs(asked.logs), rival(estimator), asked.each)
    if "time" in asked.what:
        timed()
    if "adversary" in asked.what:
        print("| plant | logs | tried | missed | by most widths | which |\n|---|---|---|---|---|---|", flush=True)
        for clean in (True, False):
            for seed, name in enumerate(("scalar, stable", "tank", "motor", "chemostat", "scalar, unstable")):
                adversary(name, seed, clean, asked.calls)


if __name__ == "__main__":
    main()
