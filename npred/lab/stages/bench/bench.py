"""The bench stage: Table I of [DAPF] with trained networks, compiled baselines, and the error of each row.

And the break-even of networks against the quickest numerical predictor of the same accuracy, on the same samples.
"""

import platform
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import groupby
from math import isfinite
from typing import Any

import h5py
import numpy as np

from npred.base import devices, grid
from npred.base.progress import counted
from npred.base.registry import METHODS, NETWORKS, short_name
from npred.kernels import compiler
from npred.kernels.kernel import bound
from npred.lab.config import Bench
from npred.lab.config.results import NUMERICAL, Benched, PredictorId
from npred.lab.config.results.bench import CallTimes, Crossover, EquivalentMethod, Hardware, Stops
from npred.lab.report import figures
from npred.lab.report.figures.style import short
from npred.lab.scheduler.job import Job
from npred.lab.stages.bench import candidates, timing
from npred.lab.stages.bench.candidates import Candidate, ErrorSizes, Reference, matching
from npred.lab.stages.report import tables
from npred.lab.training.data import shards
from npred.prediction.methods import RK4, OneStep, Predictor

STEPS = (10, 210)  # in the two runs whose difference is the cost of f
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
    crossover = crossovers(job, zip(entries, rows, strict=True), reference)
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
    us = {label: timing.quantiles(nanoseconds) for label, nanoseconds in times.items()}
    bases = {(e.predictor, e.nx, e.batch): us[e.label]["median_us"] for e in reversed(entries) if e.matches is None}
    rows = []
    for e in entries:
        over = [bases.get((base, e.nx, e.batch)) for base in ("published", "euler")]
        published, compiled = (base and base / us[e.label]["median_us"] for base in over)
        rows.append(CallTimes(
            predictor=e.predictor, runtime=e.runtime, dx=1 / (e.nx - 1), batch=e.batch, matches=e.matches,
            device=e.device, copies=e.copies, calls=len(times[e.label]), **us[e.label], eps_sup=errors[e.label].sup,
            eps_median=errors[e.label].median, speedup_published=published, speedup_compiled=compiled,
        ))  # fmt: skip
    return rows


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
    """One sentence per network, when it pays; then one on the machine."""
    return [*(row.sentence for row in result.crossover), result.stops.sentence]


def fastest(result: Benched, numerical: str) -> dict[PredictorId, float]:
    """Median µs of a call at the finest dx and batch 1: networks in their fastest runtime, the compiled method's."""
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
        f"{stops.median_us:.0f} µs in the median: p99.9 of calls from {1000 / stops.per_s:.1f} µs on includes this."
    )


def crossovers(job: Job, timed: Iterable[tuple[Candidate, CallTimes]], reference: Reference) -> list[Crossover]:
    """One row per trained network: its quickest runtime at batch 1 and the first dx, and every method as accurate."""
    single = [
        (entry, row)
        for entry, row in timed
        if entry.batch == 1 and entry.device == "cpu" and row.eps_sup and isfinite(row.eps_sup)
    ]
    first = grid.count(job.config.bench.dx[0])
    break_evens = []
    for name in sorted(set(job.config.train.models)):
        timings = [(e, row) for e, row in single if (e.predictor, e.nx, e.matches) == (name, first, None)]
        methods = [entry for entry, _ in single if entry.matches == name]
        if timings and methods:
            network, row = min(timings, key=lambda pair: pair[1].median_us)
            eps = ErrorSizes(row.eps_sup, row.eps_median)
            break_evens.append(crossover(job.config.bench, network, eps, methods, reference))
    return break_evens


def crossover(
    config: Bench, network: Candidate, eps: ErrorSizes, methods: list[Candidate], reference: Reference
) -> Crossover:
    """All timed in turn. pays_from_ns: the cost of f at which the steps of the fastest method take as long as the
    network, 0 where they do without f.
    """
    plant = reference.plant
    typical = [entry for entry in (_by_median(entry, reference, eps.median) for entry in methods) if entry]
    timed = (network, *methods, *typical)
    runs = {entry.label: entry.run for entry in timed} | {str(k): RK4(plant, k + 1) for k in STEPS}
    calls = {label: call(reference, run) for label, run in runs.items()}
    times = timing.sample(calls, config.calls, config.seconds)
    median = {label: timing.quantiles(taken)["median_us"] for label, taken in times.items()}
    few, many = (median[str(k)] for k in STEPS)
    f_ns = 1000 * (many - few) / (RK4.evaluations() * (STEPS[1] - STEPS[0]))
    best = min(methods, key=lambda entry: median[entry.label])
    network_us, best_us = median[network.label], median[best.label]
    evaluations = 1000 * best_us / f_ns  # where all of a call grows with f: an implicit step, a simulator
    if isinstance(best.run, OneStep) and not hasattr(best.run.step, "whole"):
        evaluations = best.run.evaluations() * (best.nx - 1)

    def equivalent(entries: list[Candidate]) -> list[EquivalentMethod]:
        errors = [reference.of_method(entry.run, entry.nx) for entry in entries]
        return [
            EquivalentMethod(predictor=e.predictor, steps=e.nx - 1, median_us=median[e.label], eps_sup=eps.sup,
                             eps_median=eps.median)
            for e, eps in zip(entries, errors, strict=True)
        ]  # fmt: skip

    overhead = max(best_us - f_ns * evaluations / 1000, 0.0)
    measured = Crossover(
        plant=plant.name, predictor=network.predictor, runtime=network.runtime, dx=1 / (network.nx - 1),
        eps_sup=eps.sup, eps_relative=eps.sup / float(np.abs(reference.P).max()), eps_median=eps.median,
        network_us=network_us, numerical=equivalent(methods), by_median=equivalent(typical),
        best=best.predictor, best_steps=best.nx - 1, best_us=best_us, network_speedup=best_us / network_us,
        f_ns=f_ns, pays_from_ns=1000 * max(network_us - overhead, 0.0) / evaluations,
    )  # fmt: skip
    return measured.model_copy(update={"sentence": network_pays(measured)})


def _by_median(method: Candidate, reference: Reference, eps: float) -> Candidate | None:
    """The method with as many steps as it needs for that median error."""
    kind: Any = type(method.run)
    nodes = matching(reference, kind, eps, by="median")
    run = kind(method.run.plant, nodes) if nodes else None
    return run and replace(method, nx=nodes, run=run, matches=f"{method.matches}, median")


def call(reference: Reference, run: Predictor) -> Callable[[int], None]:
    """The k-th call on a sample of the reference, as a loop makes it, on memory that is there; then the guard's."""
    plant, predict = run.plant, run.lanes()
    u = grid.means(reference.u, run.nx)
    inputs = [
        (reference.X[i][:, None].copy(), u[i][..., None].copy(), reference.D_hat[i : i + 1].copy())
        for i in range(len(reference.X))
    ]
    P, error, fallback = np.empty((run.nx, plant.n, 1)), np.empty(1), np.empty(1)
    calls = [bound(predict, *sample, 0.0, plant.p, P) for sample in inputs]
    if run.guard is None:
        return lambda k: calls[k % len(calls)]()
    checks = [bound(run.guard, *sample, 0.0, plant.p, run.settings, P, error, fallback) for sample in inputs]

    def checked(k: int) -> None:
        calls[k % len(calls)]()
        checks[k % len(checks)]()

    return checked


def network_pays(crossover: Crossover) -> str:
    """The break-even of a network in a sentence."""
    numerical, ratio = method_on(crossover.best, crossover.best_steps), crossover.network_speedup
    network = f"the {NETWORKS.label(crossover.predictor)} ({crossover.runtime}, dx = {crossover.dx:.3g})"
    first, second = (numerical, network) if ratio < 1 else (network, numerical)
    slower = [row for row in crossover.numerical if row.predictor != crossover.best]
    others = "".join(f", {method_on(row.predictor, row.steps)} {row.median_us:.1f} µs" for row in slower)
    from_ns = crossover.pays_from_ns
    pays = f"if one evaluation of f takes at least {from_ns:.0f} ns" if from_ns else "however cheap f is"
    pays += f"; here it takes {crossover.f_ns:.0f} ns"
    typical = ""
    if crossover.by_median:  # the median error may rank methods differently from the largest
        method = min(crossover.by_median, key=lambda row: row.median_us)
        times = method.median_us / crossover.network_us
        typical = (
            f" By the median error over samples, {short(crossover.eps_median)}, "
            f"{method_on(method.predictor, method.steps)} is as accurate as the network in {method.median_us:.1f} µs, "
            f"{f'{1 / times:.1f} times as fast' if times < 1 else f'{times:.1f} times its time'}."
        )
    return (
        f"For {crossover.plant} at ε = {short(crossover.eps_sup)} the fastest predictor is {first}, "
        f"{max(ratio, 1 / ratio):.1f} times as fast as {second}: the network takes {crossover.network_us:.1f} µs, "
        f"{numerical} {crossover.best_us:.1f} µs{others}.{typical} A network pays {pays}."
    )


def method_on(name: str, steps: int) -> str:
    """A method and its number of steps, in words."""
    return f"{METHODS.label(name)} on {counted(steps, 'steps')}"
