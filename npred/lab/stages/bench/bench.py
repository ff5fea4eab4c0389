"""The bench stage: Table I of [DAPF] with trained networks, compiled baselines, and the error of each row."""

import platform
from itertools import groupby

import h5py
import numpy as np

from npred.base import devices
from npred.base.registry import short_name
from npred.kernels import compiler
from npred.lab.config import Bench
from npred.lab.config.results import NUMERICAL, Benched, PredictorId
from npred.lab.config.results.bench import CallTimes, Crossover, Hardware, Stops
from npred.lab.report import figures
from npred.lab.scheduler.job import Job
from npred.lab.stages.bench import break_even, candidates, timing
from npred.lab.stages.bench.candidates import Candidate, ErrorSizes, Reference
from npred.lab.stages.report import tables
from npred.lab.training.data import shards

PACKAGES = ("npred", "torch", "numpy", "onnxruntime")


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
    rows = _rows(entries, times, errors)
    job.progress.doing("bench", "timing f")
    crossover = break_even.measure(job, zip(entries, rows, strict=True), reference)
    stops = Stops.model_validate(timing.stops())
    stops = stops.model_copy(update={"sentence": stopped(stops)})
    versions = {"python": platform.python_version(), "compiler": compiler.version()} | devices.packages(*PACKAGES)
    machine = devices.hardware(job.device) | {"threads": config.threads, "versions": versions}
    job.progress.doing("bench", "drawing")
    (job.folder / "bench.tex").write_text(tables.by_dx(rows).latex(), encoding="utf-8")
    figures.write(figures.speed(rows), job.folder)
    return Benched(
        rows=rows, calls=config.calls, crossover=crossover, stops=stops, hardware=Hardware.model_validate(machine)
    )


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


def _rows(entries: list[Candidate], times: dict[str, np.ndarray], errors: dict[str, ErrorSizes]) -> list[CallTimes]:
    """A row of each entry, with its speed-up by medians over the published predictor and compiled Euler at that dx."""
    rows = [
        CallTimes(
            predictor=entry.predictor, runtime=entry.runtime, dx=1 / (entry.nx - 1), batch=entry.batch,
            matches=entry.matches, device=entry.device, copies=entry.copies, calls=len(times[entry.label]),
            **timing.quantiles(times[entry.label]), eps_sup=errors[entry.label].sup,
            eps_median=errors[entry.label].median,
        )
        for entry in entries
    ]  # fmt: skip
    medians = {(r.predictor, r.dx, r.batch): r.median_us for r in reversed(rows) if r.matches is None}
    compared = []
    for row in rows:
        over = {base: medians.get((base, row.dx, row.batch)) for base in ("published", "euler")}
        published, compiled = (base and base / row.median_us for base in over.values())
        compared.append(row.model_copy(update={"speedup_published": published, "speedup_compiled": compiled}))
    return compared


def summary(result: Benched, width: int | None = None) -> str:
    """Each predictor's median and error, and the sentences on them; without the rows that only a figure needs."""
    return _text(result, tables.speed(result.rows, wide=False).terminal(width))


def details(result: Benched, width: int | None = None) -> str:
    """Every row with the tails of its times and its speed-ups, in a table wider than most screens."""
    return _text(result, tables.speed(result.rows, front=True).terminal(width))


def _text(result: Benched, table: str) -> str:
    title = f"microseconds per call, up to {result.calls} calls, {result.hardware.cpu}"
    return "\n".join([title, "", table, "", *sentences(result)])


def sentences(result: Benched) -> list[str]:
    """One sentence per network, when it pays; then one on the machine. They are put anew, as results keep old words."""
    return [*(break_even.network_pays(row, timed_dx(result, row)) for row in result.crossover), result.stops.sentence]


def timed_dx(result: Benched, crossover: Crossover) -> float | None:
    """The dx of the network's call in a crossover; None where no row of the benchmark is that call."""
    call = (crossover.predictor, crossover.runtime, crossover.eps_sup)
    return next((row.dx for row in result.table if (row.predictor, row.runtime, row.eps_sup) == call), None)


def fastest(result: Benched, numerical: str) -> dict[PredictorId, float]:
    """The median µs of a call at the finest dx and batch 1: each network's in its fastest runtime, and the compiled
    numerical predictor's.
    """
    finest = min((row.dx for row in result.table), default=0.0)
    times: dict[PredictorId, float] = {}
    for row in result.table:
        if row.dx == finest and (row.is_network or (row.predictor, row.runtime) == (short_name(numerical), "compiled")):
            predictor = PredictorId(row.predictor) if row.is_network else NUMERICAL
            times[predictor] = min(times.get(predictor, row.median_us), row.median_us)
    return times


def stopped(stops: Stops) -> str:
    """The machine's share in the tails, in a sentence; see timing.stops."""
    if not stops.per_s:
        return "The machine did not stop a thread that only reads the clock: the tails are the predictors'."
    return (
        f"The machine stops a thread that only reads the clock {stops.per_s:.0f} times per second, for "
        f"{stops.median_us:.0f} µs in the median: from {1000 / stops.per_s:.1f} µs per call on, p99.9 includes that."
    )
