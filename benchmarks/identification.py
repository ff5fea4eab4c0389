"""What `npred.identify` says of simulated logs.

    python benchmarks/identification.py [clean] [disturbed] [structure] [closed] [periodic] [silent] [parameters]
        [--logs 200] [--only 17] [--each] [--jobs 2]

Prints Markdown tables. Errors and widths are in sampling periods, of every input's delay. An answer is certain where it
calls the delay identifiable; a log that is refused has none. `missed` counts certain intervals without the truth, 1 in
20 by the meaning of 95 %. `false` counts those off by more than half their width (0.1 periods at least), 3.9 deviations
of a normal error, which chance gives 1 of 10 000; each of them is printed. The truth is the range in
`simulated_logs.Sample`. Of a periodic input it is D alone, for the answer may say that it knows D only up to periods: a
certain answer whole periods off is false, and counted as `a period off` too. Logs of `silent` cannot tell: none should
be certain.
"""

import multiprocessing
import tempfile
import time
import warnings
from collections import namedtuple
from collections.abc import Callable, Iterable
from typing import Any

import harness
import numpy as np
from simulated_logs import KINDS, Sample, log_of

from npred import plants
from npred.identification.identify import identify
from npred.plants import Plant

COUNTS = {"clean": 200, "disturbed": 200, "structure": 40, "closed": 40, "periodic": 20, "silent": 50,
          "parameters": 200}  # fmt: skip
SLIGHT = 0.05  # periods
# D (m,), interval (m, 2), certain (m,), the free parameters' values and intervals, words of a refusal
Answer = namedtuple("Answer", "D interval certain parameters parameter_intervals words", defaults=({}, {}, ""))
Verdict = namedtuple("Verdict", "refused certain missed false turned widths error held width")  # lengths in periods
Mapped = Callable[..., Iterable[Any]]  # map, or that of a pool
ACTS = {"push_kind": "push", "push_period": "push", "damping": "mode", "share": "later"}  # settings, where they act
SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def plant_of(kind: str, unit: str = "s") -> Plant:
    """The plant of a kind of logs, in its unit of time."""
    name = KINDS[kind].declaration.__name__
    return plants.make(name, type(name, (KINDS[kind].declaration,), {"time_unit": unit}))


def ours(log: Sample) -> Answer:
    """`npred.identify`'s answer: of arrays in seconds, of tables with stamps in seconds in minutes, dates in hours."""
    plant, stamps = plant_of(log.kind, log.unit), SECONDS[log.unit] * log.t
    options = {"free": log.about["free"], "longest": log.about["longest"] and log.about["longest"] * log.period}
    if log.unit == "h":
        stamps = np.datetime64("2024-01-01T08:00:00") + (1e6 * stamps).astype("timedelta64[us]")
    try:
        if log.unit == "s":
            r = identify(plant, log.t, log.U, log.X, **options)
        else:
            with tempfile.NamedTemporaryFile(suffix=".csv") as file:
                rows = np.column_stack([a.astype(str) for a in (stamps, log.U, log.X)])
                names = ["t [s]" if log.unit == "min" else "time", *plant.inputs, *plant.outputs]
                np.savetxt(file.name, rows, "%s", ",", header=",".join(names), comments="")
                r = identify(plant, file.name, **options)
    except Exception as error:  # a sentence that refuses, or a fault; it is printed
        blank = np.full((plant.m, 2), np.nan)
        return Answer(blank[:, 0], blank, blank[:, 0] == 0, words=f"{type(error).__name__}: {error}")
    return Answer(r.D, r.interval, r.identifiable, r.parameters, r.parameter_intervals)


def judged(log: Sample, answer: Answer) -> list[Verdict]:
    """The verdict on each delay: see the top."""
    rows, T = [], log.period
    for (low, high), D, (a, b), certain in zip(log.D, answer.D, answer.interval, answer.certain, strict=True):
        shift = np.round((D - low) / log.repeats) * log.repeats
        off, turned = (max(low + s - b, a - high - s) / T for s in (0.0, shift))
        widths, turned = (v / max((b - a) / T, 2 * SLIGHT) for v in (off, turned))
        held, false = off <= 1e-6, certain and widths > 0.5
        rows.append(Verdict(
            bool(answer.words), certain, certain and not held, false, false and turned <= 0.5,
            max(widths, -1.0) if certain else -2.0, max(low - D, D - high, 0 * D) / T,
            np.nan if answer.words else held, (b - a) / T,
        ))  # fmt: skip
    return rows


def described(log: Sample, answer: Answer) -> str:
    """The truth, the answer, and the log's settings, in one line; delays in periods."""
    about = {k: round(v, 3) if isinstance(v, float) else v for k, v in log.about.items()
             if v and k not in ("off", "free_off", "integral") and log.about[ACTS.get(k, k)]}  # fmt: skip
    words = answer.words or f"{(answer.interval / log.period).round(3).tolist()} certain {answer.certain.tolist()}"
    return f"{log.kind}, {log.why}: truth {(log.D / log.period).round(2).tolist()}, answer {words}, {about}"


def row(task: tuple[str, int]) -> tuple[str, list[Verdict], list[Any], float, str]:
    """Log k of a set: its kind, verdicts, (held, relative error) of each free parameter, seconds, and words."""
    warnings.simplefilter("ignore")
    log, begin = log_of(*task), time.perf_counter()
    said = ours(log)
    verdicts, seconds = judged(log, said), time.perf_counter() - begin
    free = [(low <= log.parameters[name] <= high, abs(said.parameters[name] / log.parameters[name] - 1))
            for name, (low, high) in said.parameter_intervals.items() if name in log.parameters]  # fmt: skip
    mark = "FALSE " if any(v.false for v in verdicts) else "REFUSED " if said.words else ""
    return log.why, verdicts, free, seconds, f"{mark}{task[0]} {task[1]} {described(log, said)}, {seconds:.1f} s"


def table(tasks: list[tuple[str, int]], mapped: Mapped, each: bool) -> None:
    """One row by kind of log and one in all; false answers, refusals and free parameters apart."""
    groups: dict[str, list[Any]] = {}
    for one in mapped(row, tasks):
        groups.setdefault(one[0], []).append(one)
        if each or one[-1].startswith(("FALSE", "REFUSED")):
            print(one[-1], flush=True)
    counted = "delays", "refused", "certain", "missed", "false", "a period off", "by most widths", "median error"
    harness.head("of", *counted, "95 % below", "intervals that hold", "median width", "s a delay")
    groups["all"] = [one for rows in groups.values() for one in rows]
    for why, rows in groups.items():
        v = Verdict(*np.array([v for one in rows for v in one[1]], dtype=float).T)
        counts, error = [f"{sum(column):.0f}" for column in v[:5]], np.array(v.error)
        harness.row(
            why, len(error), *counts, f"{max(*v.widths, 0):.2f}", f"{np.nanmedian(error):.3f}",
            f"{np.nanquantile(error, 0.95):.2f}", f"{np.nanmean(v.held):.1%}", f"{np.nanmedian(v.width):.2f}",
            f"{sum(one[3] for one in rows) / len(error):.2f}",
        )  # fmt: skip
    wrong = sum(any(v.false for v in one[1]) for one in groups["all"])
    print(f"false and certain: {wrong} of {len(groups['all'])} logs")
    for why, rows in groups.items():
        if free := [parameter for one in rows for parameter in one[2]]:
            held, error = np.array(free, dtype=float).T
            print(f"parameters of {why}: {held.mean():.1%} of {len(held)} intervals hold, median error "
                  f"{np.median(error):.2%}, 95 % below {np.quantile(error, 0.95):.1%}", flush=True)  # fmt: skip


if __name__ == "__main__":
    asked = harness.options(__doc__, {"what": COUNTS}, logs=1000, only=[int], each=False, jobs=1)
    tasks = {what: [(what, k) for k in asked.only or range(min(n, asked.logs))] for what, n in COUNTS.items()}
    with multiprocessing.Pool(asked.jobs) as pool:
        mapped = pool.imap if asked.jobs > 1 else map
        for what in (name for name in COUNTS if name in asked.what):
            print(f"\n## {what}", flush=True)
            table(tasks[what], mapped, asked.each)
