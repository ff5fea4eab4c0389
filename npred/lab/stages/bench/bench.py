"""The bench stage: Table I of [DAPF] with trained networks, compiled baselines, and the error of each row."""

import platform
from itertools import groupby

import h5py
import numpy as np

from npred.base import devices
from npred.kernels import compiler
from npred.lab.config import Bench
from npred.lab.config.results import Benched
from npred.lab.config.results.bench import CallTimes, Hardware, Stops
from npred.lab.report import figures
from npred.lab.scheduler.job import Job
from npred.lab.stages.bench import break_even, candidates, timing, timing_tables
from npred.lab.stages.bench.candidates import Candidate, ErrorSizes, Reference
from npred.lab.stages.report import tables
from npred.lab.training.data import shards

PACKAGES = ("npred", "torch", "numpy", "onnxruntime")
summary, details = timing_tables.summary, timing_tables.details


def run(job: Job) -> Benched:
    """Time every predictor at every dx, as a loop calls it, and take its error on held-out samples.

    Protocol of [DAPF, Table I]: state at the box's corner, u(x) = x, D_hat ~ U(0.5, 1.7). Writes times.h5 (each call's
    nanoseconds), bench.tex (booktabs), speed.svg and speed.png (latency against error). `crossover` says when a network
    pays, one row per network; `stops` is the share of the machine in the tails.
    """
    config = job.config.bench
    devices.torch_threads(config.threads)
    reference = Reference.of(job.plant, shards.survey(job.inputs["generate"] / "data.h5").subset(test=True))
    job.progress.doing("bench", "compiling")
    entries = candidates.entries(job, reference)
    job.progress.doing("bench", "measuring errors")
    errors = {entry.label: reference.error(entry) for entry in entries}
    times = _times(job, config, entries)
    rows = _speedups([_row(entry, times[entry.label], errors[entry.label]) for entry in entries])
    job.progress.doing("bench", "timing f")
    crossover = break_even.measure(job, zip(entries, rows, strict=True), reference)
    stops, hardware = Stops.model_validate(timing.stops()), _hardware(job.device, config)
    stops = stops.model_copy(update={"sentence": timing_tables.stopped(stops)})
    job.progress.doing("bench", "drawing")
    (job.folder / "bench.tex").write_text(tables.by_dx(rows).latex(), encoding="utf-8")
    figures.write(figures.speed(rows), job.folder)
    return Benched(rows=rows, calls=config.calls, crossover=crossover, stops=stops, hardware=hardware)


def _times(job: Job, config: Bench, entries: list[Candidate]) -> dict[str, np.ndarray]:
    """Nanoseconds of each call of each entry, by label; one group after the other."""
    times: dict[str, np.ndarray] = {}
    calls = {e.label: candidates.call(job, e, config.calls) for e in sorted(entries, key=lambda entry: entry.group)}
    with np.errstate(all="ignore"):  # with few steps a method may diverge: its error says so
        counts = {label: timing.affordable(call, config.calls, config.seconds) for label, call in calls.items()}
        with job.progress.bar("bench", sum(counts.values()), "calls") as bar:
            for _, group in groupby(calls, key={entry.label: entry.group for entry in entries}.__getitem__):
                times |= timing.sample({label: calls[label] for label in group}, counts, progress=bar.advance)
    with h5py.File(job.folder / "times.h5", "w") as file:
        for label, samples in times.items():
            file.create_dataset(label.replace("/", " "), data=samples).attrs["unit"] = "ns"
    return times


def _row(entry: Candidate, nanoseconds: np.ndarray, eps: ErrorSizes) -> CallTimes:
    return CallTimes(
        predictor=entry.predictor, runtime=entry.runtime, dx=1 / (entry.nx - 1), batch=entry.batch,
        matches=entry.matches, device=entry.device, copies=entry.copies, calls=len(nanoseconds),
        **timing.quantiles(nanoseconds), eps_sup=eps.sup, eps_median=eps.median,
    )  # fmt: skip


def _speedups(rows: list[CallTimes]) -> list[CallTimes]:
    """Each row with its speed-up by medians over the published predictor and over compiled Euler at the same dx."""
    medians = {(r.predictor, r.dx, r.batch): r.median_us for r in reversed(rows) if r.matches is None}

    def ratio(row: CallTimes, predictor: str) -> float | None:
        base = medians.get((predictor, row.dx, row.batch))
        return None if base is None else base / row.median_us

    ratios = {"speedup_published": "published", "speedup_compiled": "euler"}
    return [row.model_copy(update={key: ratio(row, base) for key, base in ratios.items()}) for row in rows]


def _hardware(device: str, config: Bench) -> Hardware:
    versions = {"python": platform.python_version(), "compiler": compiler.version()} | devices.packages(*PACKAGES)
    return Hardware.model_validate(devices.hardware(device) | {"threads": config.threads, "versions": versions})
