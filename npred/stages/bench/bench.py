"""The bench stage: Table I of [DAPF] with trained networks, compiled baselines, and the error of each row."""

import platform
from itertools import groupby
from typing import Any

import h5py
import numpy as np

from npred import figures
from npred.config import Bench
from npred.data import shards
from npred.loop import metrics
from npred.parallel import devices
from npred.stages import Job
from npred.stages.bench import break_even, candidates, timing, timing_tables
from npred.stages.bench.candidates import Entry, Reference
from npred.stages.report import tables

PACKAGES = ("npred", "torch", "numpy", "numba", "onnxruntime")
summary, details = timing_tables.summary, timing_tables.details


def run(job: Job) -> dict[str, Any]:
    """Time every predictor at every dx, as a loop calls it, and take its error on held-out samples.

    Protocol of [DAPF, Table I]: state at the box's corner, u(x) = x, D_hat ~ U(0.5, 1.7). Writes times.h5 (each call's
    nanoseconds), bench.tex (booktabs), speed.svg and speed.png (latency against error). `crossover` says when a network
    pays, one row per network; `stops` what of the tails is the machine's own.
    """
    import torch

    config = job.config.bench
    torch.set_num_threads(config.threads)
    reference = Reference(job.plant, shards.survey(job.inputs["generate"] / "data.h5").subset(test=True))
    job.progress.doing("bench", "compiling")
    entries = candidates.entries(job, reference)
    job.progress.doing("bench", "measuring errors")
    errors = {entry.label: reference.error(entry) for entry in entries}
    times = _times(job, config, entries)
    rows = _speedups([_row(entry, times[entry.label], errors[entry.label]) for entry in entries])
    job.progress.doing("bench", "timing f")
    found = break_even.measure(job, zip(entries, rows, strict=True), reference)
    result = {"rows": rows, "calls": config.calls}
    result |= {"crossover": [one | {"sentence": break_even.sentence(one)} for one in found]}
    stops = timing.stops()
    result |= {"stops": stops | {"sentence": timing_tables.stopped(stops)}}
    result |= {"hardware": _hardware(job, config)}
    job.progress.doing("bench", "drawing")
    (job.folder / "bench.tex").write_text(tables.by_dx(rows).latex(), encoding="utf-8")
    figures.write(figures.speed(rows), job.folder)
    return result


def _times(job: Job, config: Bench, entries: list[Entry]) -> dict[str, np.ndarray]:
    """Nanoseconds of each call of each entry, by label; one group after the other."""
    times: dict[str, np.ndarray] = {}
    ordered = sorted(entries, key=lambda entry: entry.group)
    with job.progress.bar("bench", len(entries) * config.calls, "calls") as bar:
        for _, group in groupby(ordered, key=lambda entry: entry.group):
            calls = {entry.label: candidates.call(job, entry, config.calls) for entry in group}
            with np.errstate(all="ignore"):  # with few steps a method may diverge: its error says so
                times |= timing.sample(calls, config.calls, config.seconds, bar.advance)
    with h5py.File(job.folder / "times.h5", "w") as file:
        for label, samples in times.items():
            file.create_dataset(label.replace("/", " "), data=samples).attrs["unit"] = "ns"
    return times


def _row(entry: Entry, nanoseconds: np.ndarray, eps: float) -> dict[str, Any]:
    question = {"predictor": entry.predictor, "runtime": entry.runtime, "dx": 1 / (entry.nx - 1), "batch": entry.batch}
    where = {"matches": entry.matches, "device": entry.device, "copies": entry.copies, "calls": len(nanoseconds)}
    return {**question, **where, **timing.quantiles(nanoseconds), "eps_sup": metrics.number(eps)}


def _speedups(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each row with its speed-up by medians over the published predictor and over compiled Euler at the same dx."""

    def base(row: dict[str, Any], predictor: str) -> float | None:
        alike = [r for r in rows if r["predictor"] == predictor and r["matches"] is None]
        same = [r for r in alike if (r["dx"], r["batch"]) == (row["dx"], row["batch"])]
        return same[0]["median_us"] / row["median_us"] if same else None

    return [r | {"speedup_published": base(r, "published"), "speedup_compiled": base(r, "euler")} for r in rows]


def _hardware(job: Job, config: Bench) -> dict[str, Any]:
    versions = {"python": platform.python_version()} | devices.packages(*PACKAGES)
    return devices.hardware(job.device) | {"threads": config.threads, "versions": versions}
