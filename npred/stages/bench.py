"""The bench stage: Table I of [DAPF] with trained networks, compiled baselines, and the error of each row."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from npred import devices, grid, operators, randomness, timing
from npred.config import Bench
from npred.dataset import Dataset
from npred.plants import Plant
from npred.predictors import RK4, Euler, Heun, Predictor
from npred.predictors.interpreted import EulerPython, Published
from npred.stages import Job
from npred.stages.starts import box

FINE = 2001  # nodes of the reference
PROBES = 200  # held-out samples that a row's error is taken over
COARSEST = 3  # nodes that RK4 at equal accuracy starts from


@dataclass(frozen=True)
class Entry:
    """A contender at one grid; `matches` names the network whose accuracy set its grid."""

    predictor: str
    runtime: str
    nx: int
    batch: int
    run: Predictor
    matches: str | None = None

    @property
    def label(self) -> str:
        """What tells its raw times from the others'."""
        return "/".join(str(v) for v in (self.predictor, self.runtime, self.nx, self.batch, self.matches or "grid"))


def run(job: Job) -> dict[str, Any]:
    """Time `calls` calls of every predictor at every dx, as a loop makes them, and take its error on held-out samples.

    Protocol of [DAPF, Table I]: state at the box's corner, u(x) = x, D_hat ~ U(0.5, 1.7). Writes times.h5, raw.
    """
    import torch

    config = job.config.bench
    torch.set_num_threads(config.threads)
    probe = _Probe(job.plant, Dataset.read(job.inputs["generate"] / "data.h5").subset(test=True))
    networks = {name: operators.load(job.inputs[name], job.plant) for name in sorted(set(job.config.train.models))}
    entries, errors = _entries(job, config, networks, probe)
    times = {}
    with job.progress.bar("bench", len(entries) * config.calls, "call") as bar:
        for group in _groups(entries):
            calls = {e.label: _call(job, e, config.calls) for e in group}
            times |= timing.sample(calls, config.calls, bar.advance)
    with h5py.File(job.folder / "times.h5", "w") as file:
        for label, samples in times.items():
            file.create_dataset(label.replace("/", " "), data=samples).attrs["unit"] = "ns"
    rows = [_row(e, times[e.label], errors[e.label]) for e in entries]
    return {"rows": _speedups(rows), "calls": config.calls, "hardware": _hardware(job, config)}


class _Probe:
    """Held-out samples with their reference on a fine grid, to take any row's error on.

    Only samples after the first delay: before, u jumps from its past to the first control, and there every scheme is of
    first order, so that no row would show what it can do.
    """

    def __init__(self, plant: Plant, test: Dataset) -> None:
        later = np.flatnonzero(test.t > test.D)
        rows = later[np.linspace(0, len(later) - 1, min(PROBES, len(later))).astype(int)]
        self.X, self.u, self.D_hat = test.X[rows], test.u[rows], test.D_hat[rows]
        self.P = RK4(plant)(self.X, grid.refine(self.u, FINE), self.D_hat)

    def error(self, predictor: Predictor, nx: int) -> float:
        """sup |P_hat - P| over samples and the row's nodes."""
        P_hat = predictor(self.X, grid.refine(self.u, nx), self.D_hat)
        return float(np.linalg.norm(P_hat - grid.refine(self.P, nx), axis=-1).max())


def _entries(job: Job, config: Bench, networks: dict[str, Any], probe: _Probe) -> tuple[list[Entry], dict[str, float]]:
    from npred.predictors.neural import Neural

    entries, errors = [], {}

    def add(name: str, runtime: str, nx: int, batch: int, run: Predictor, matches: str | None = None) -> None:
        entry = Entry(name, runtime, nx, batch, run, matches)
        entries.append(entry)
        errors[entry.label] = probe.error(run, nx)

    for batch in config.batches:
        for nx in map(grid.count, config.dx):
            if batch == 1:
                for interpreted in (Published, EulerPython):
                    add(interpreted.name, "python", nx, batch, interpreted(job.plant, nx))
            for method in (Euler, Heun, RK4):
                add(method.name, "compiled", nx, batch, method(job.plant, nx))
            for name, operator in networks.items():
                neural = Neural(job.plant, operator, nx, job.device, name)
                add(name, "torch", nx, batch, neural)
                if nx == grid.count(config.dx[0]):
                    coarse = _equal_accuracy(job.plant, probe, errors[entries[-1].label])
                    add("rk4", "compiled", coarse, batch, RK4(job.plant, coarse), matches=name)
    return entries, errors


def _equal_accuracy(plant: Plant, probe: _Probe, eps: float) -> int:
    """The fewest nodes, doubling the intervals, on which RK4 is at least as accurate as eps."""
    intervals = COARSEST - 1
    while intervals < FINE and probe.error(RK4(plant), intervals + 1) > eps:
        intervals *= 2
    return intervals + 1


def _groups(entries: list[Entry]) -> list[list[Entry]]:
    """Entries that are timed in turn: one group a dx and batch, so that ratios are of the same minutes."""
    keys = sorted({(e.batch, e.nx) for e in entries if e.matches is None})
    groups = {key: [e for e in entries if (e.batch, e.nx) == key and e.matches is None] for key in keys}
    for entry in entries:
        if entry.matches:
            groups[min(key for key in keys if key[0] == entry.batch)].append(entry)
    return list(groups.values())


def _call(job: Job, entry: Entry, count: int) -> Callable[[int], None]:
    """The k-th call as a loop makes it: on preallocated memory, lanes last."""
    n, m, lanes = job.plant.n, job.plant.m, entry.batch
    X = np.tile(box(job.plant, job.config)[:, :1], (1, lanes))
    u = np.tile(grid.nodes(entry.nx)[:, None, None], (1, m, lanes))
    D_hat = randomness.generator(job.config.seed, "bench").uniform(0.5, 1.7, (count, lanes))
    P, p, predict = np.empty((entry.nx, n, lanes)), job.plant.p, entry.run.lanes()

    def call(k: int) -> None:
        predict(X, u, D_hat[k], 0.0, p, P)

    return call


def _row(entry: Entry, nanoseconds: np.ndarray, eps: float) -> dict[str, Any]:
    question = {"predictor": entry.predictor, "runtime": entry.runtime, "dx": 1 / (entry.nx - 1), "batch": entry.batch}
    return {**question, "matches": entry.matches, **timing.quantiles(nanoseconds), "eps_sup": eps}


def _speedups(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each row with its speed-up by medians over the published predictor and over compiled Euler at the same dx."""

    def base(row: dict[str, Any], predictor: str) -> float | None:
        same = [r for r in rows if r["predictor"] == predictor and (r["dx"], r["batch"]) == (row["dx"], row["batch"])]
        return same[0]["median_us"] / row["median_us"] if same else None

    return [r | {"speedup_published": base(r, "published"), "speedup_compiled": base(r, "euler")} for r in rows]


def _hardware(job: Job, config: Bench) -> dict[str, Any]:
    versions = {name: devices.package(name) for name in ("npred", "torch", "numpy", "numba")}
    return devices.hardware(job.device) | {"threads": config.threads, "versions": versions}


def summary(result: dict[str, Any]) -> Any:
    """The rows as a table."""
    from rich.table import Table

    table = Table(title=f"microseconds a call, {result['calls']} calls, {result['hardware']['cpu']}")
    for column in (
        "predictor",
        "runtime",
        "dx",
        "batch",
        "median",
        "p95",
        "p99.9",
        "max",
        "ε sup",
        "× published",
        "× euler",
    ):
        table.add_column(column, justify="left" if column in ("predictor", "runtime") else "right")
    for row in result["rows"]:
        name = row["predictor"] + (f" (ε of {row['matches']})" if row["matches"] else "")
        times = [f"{row[key]:.1f}" for key in ("median_us", "p95_us", "p999_us", "max_us")]
        ratios = ["" if row[key] is None else f"{row[key]:.3g}" for key in ("speedup_published", "speedup_compiled")]
        table.add_row(
            name, row["runtime"], f"{row['dx']:.3g}", str(row["batch"]), *times, f"{row['eps_sup']:.2e}", *ratios
        )
    return table
