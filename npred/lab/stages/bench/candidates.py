"""The candidates that are timed: each predictor at each dx and batch, in each runtime and on each device."""

import ctypes
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from npred import networks as runtimes
from npred.base import grid, randomness
from npred.base.errors import EXTRAS, ConfigError, MissingError, installed
from npred.base.registry import BASELINES, short_name
from npred.kernels.kernel import address, bound
from npred.lab.config import Bench, Pipeline
from npred.lab.config.conditions import box
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.job import Job
from npred.lab.training.data.dataset import Dataset
from npred.networks.fused import lowering
from npred.networks.weights import TrainedOperator, read
from npred.plants import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4, OneStep, Predictor, method
from npred.prediction.methods.rollout import Rollout

FINE = 2001  # nodes of the reference
PROBES = 200  # held-out samples that a row's error is taken over
Method = type[OneStep] | type[Rollout]
LADDER = sorted({round(1.2**k) for k in range(42)} | {FINE - 1})  # numbers of intervals to try
PACKAGES = {"torch": ("torch",), "onnx": ("torch", "onnx", "onnxscript", "onnxruntime")}  # packages that runtimes need
FRONT = (4, 10, 20, 50)  # intervals of the compiled methods' coarse end


@dataclass(frozen=True)
class Candidate:
    """A predictor at one grid; `matches` names the network whose accuracy set its grid, or `front`.

    `copies`, for a GPU: whether the time includes copies of samples from and to the host's memory.
    """

    predictor: str
    runtime: str
    nx: int
    batch: int
    run: Predictor
    matches: str | None = None
    device: str = "cpu"
    copies: bool | None = None

    @property
    def label(self) -> str:
        """Its name among the raw times."""
        parts = (self.predictor, self.runtime, self.nx, self.batch, self.matches or "grid", self.device, self.copies)
        return "/".join(str(part) for part in parts)

    @property
    def group(self) -> tuple[int, int]:
        """Entries of a group are timed in turn, so that their ratios are of the same minutes."""
        return self.batch, 0 if self.matches else self.nx


class ErrorSizes(NamedTuple):
    """|P_hat - P|, the largest over nodes: the largest and the median over samples."""

    sup: float
    median: float


class Reference:
    """Samples with their P on a fine grid, to take any predictor's error on.

    X (B, n), u (B, nx, m), D_hat and t (B,). Between these nodes u is what RK4 reads there: on the same nodes its error
    leaves out that of reading u; on others the nodes have the means of that u.
    """

    def __init__(self, plant: Plant, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: np.ndarray) -> None:
        self.plant, self.X, self.u, self.D_hat, self.t = plant, X, u, D_hat, t
        self.P = RK4(plant)(X, grid.means(u, FINE), D_hat, t)
        self._known: dict[tuple[str, str, int], ErrorSizes] = {}

    @classmethod
    def of(cls, plant: Plant, test: Dataset) -> Self:
        """At most PROBES of the samples, spread over them.

        Only samples after the first delay: before, u jumps from its past to the first control, and there every scheme
        is of first order, so that no row would show what it can do. Imported samples do not say when they are: all are
        taken. Raises ConfigError where no sample is left.
        """
        later = np.flatnonzero(~(test.t <= test.D))
        if not len(later):
            what, cure = "bench: expected held-out samples after the first delay", "lengthen generate.t_end"
            raise ConfigError(f"{what}, got {len(test)} before it; {cure}")
        rows = later[np.linspace(0, len(later) - 1, min(PROBES, len(later))).astype(int)]
        return cls(plant, test.X[rows], test.u[rows], test.D_hat[rows], test.t[rows])

    def error(self, entry: Candidate) -> ErrorSizes:
        """The errors of an entry on its nodes, taken once for all batches and devices."""
        key = entry.predictor, entry.runtime, entry.nx
        if key not in self._known:
            self._known[key] = self.errors(entry.run, entry.nx)
        return self._known[key]

    def of_method(self, run: Predictor, nx: int) -> ErrorSizes:
        """The errors of a numerical method on nx nodes."""
        return self.error(Candidate(run.name, "compiled", nx, 1, run))

    def errors(self, predictor: Predictor, nx: int) -> ErrorSizes:
        with np.errstate(over="ignore", invalid="ignore"):  # few steps may diverge: an infinite error
            P_hat = predictor(self.X, grid.means(self.u, nx), self.D_hat, self.t)
            gaps = np.linalg.norm(P_hat - grid.refine(self.P, nx), axis=-1)
        largest = np.nan_to_num(gaps, nan=np.inf, posinf=np.inf).max(axis=1)
        return ErrorSizes(float(largest.max()), float(np.median(largest)))


def entries(job: Job, reference: Reference) -> list[Candidate]:
    """Every candidate; a note of runtimes without their packages. Raises MissingError where none is left."""
    config, models = job.config.bench, job.config.train.models
    networks = {name: _network(job, name) for name in models}
    available, methods = _available(job.progress, config), one_step_methods(job.config, job.plant)
    ways = dict.fromkeys(models, available)
    for name, operator in networks.items():
        if "fused" in available and not lowering(operator):
            job.progress.note(f"bench: no rows of the runtime fused for {name}, for it has no fused form")
            ways[name] = [runtime for runtime in available if runtime != "fused"] or ["torch"]

    @cache  # an ONNX graph takes seconds, and serves any batch
    def run(name: str, runtime: str, nx: int) -> Predictor:
        return runtimes.predictor(runtime, job.plant, networks[name], nx, name)

    rows: list[Candidate] = []
    for batch in config.batches:
        for nx in map(grid.count, config.dx if batch == 1 else config.dx[:1]):
            kinds = (BASELINES.subclass("bench.baselines", s, Predictor) for s in config.baselines if batch == 1)
            rows += [Candidate(run.name, "python", nx, 1, run) for run in (kind(job.plant, nx) for kind in kinds)]
            rows += [Candidate(name, "compiled", nx, batch, kind(job.plant, nx)) for name, kind in methods.items()]
            for name in models:
                rows += [Candidate(name, short_name(way), nx, batch, run(name, way, nx)) for way in ways[name]]
                if job.device != "cpu":
                    moved = runtimes.predictor("torch", job.plant, _network(job, name), nx, name, job.device)
                    for copies in (True, False):
                        rows.append(Candidate(name, "torch", nx, batch, moved, device=job.device, copies=copies))
    nx = grid.count(config.dx[0])
    for name in models:
        eps = reference.error(next(e for e in rows if (e.predictor, e.nx) == (name, nx))).sup
        rows += rivals(methods, reference, eps, name)
    coarse_grids = [(k + 1, rival) for k in FRONT for rival in methods]
    coarse = ((nx, rival, methods[rival](job.plant, nx)) for nx, rival in coarse_grids)
    return rows + [Candidate(rival, "compiled", nx, 1, run, "front") for nx, rival, run in coarse]


def _network(job: Job, name: str) -> TrainedOperator:
    return read(job.inputs[name], job.plant, table=job.config.train.table(name))


def rivals(methods: dict[str, Method], reference: Reference, eps: float, name: str) -> list[Candidate]:
    """The methods that reach the error eps of the network `name`, each on the fewest nodes that do."""
    return [
        Candidate(rival, "compiled", nx, 1, kind(reference.plant, nx), name)
        for rival, kind in methods.items()
        if (nx := matching(reference, kind, eps))
    ]


def one_step_methods(config: Pipeline, plant: Plant) -> dict[str, Method]:
    """The pipeline's methods of a step per interval that serve the plant, by their rows' names."""
    kinds = {short_name(spec): method(spec) for spec in config.methods}
    refusal = problem_of(plant).refusal
    return {n: kind for n, kind in kinds.items() if issubclass(kind, OneStep | Rollout) and not refusal(kind.name)}


def matching(reference: Reference, method: Method, eps: float, by: Literal["sup", "median"] = "sup") -> int | None:
    """The fewest nodes from which on the method's error `by` is at most eps; a single grid may fit u by luck.

    None where even the reference's nodes are not enough.
    """
    run = method(reference.plant)

    def suffices(intervals: int) -> bool:
        return getattr(reference.of_method(run, intervals + 1), by) <= eps

    sufficient: list[int] = []
    for intervals in reversed(LADDER):
        if not suffices(intervals):
            if not sufficient:
                return None
            return bisect_left(range(sufficient[-1]), True, intervals + 1, key=suffices) + 1
        sufficient.append(intervals)
    return sufficient[-1] + 1


def _available(progress: Console, config: Bench) -> list[str]:
    """The runtimes whose packages are installed, with a note of the others."""
    missing = {name: [p for p in PACKAGES.get(name, ()) if not installed(p)] for name in config.runtimes}
    for name, packages in missing.items():
        if not packages:
            continue
        if set(config.runtimes) == {name}:
            expected, extra = f"expected the package {packages[0]} for the one runtime {name}, found none", EXTRAS[name]
            cure = f"pip install 'npred[{extra}]', or name fused in [bench] runtimes"
            raise MissingError(f"bench: {expected}; {cure}")
        progress.note(f"bench: no rows of the runtime {name} without {', '.join(packages)}")
    return [name for name in config.runtimes if not missing[name]]


def call(job: Job, entry: Candidate, count: int) -> Callable[[int], None]:
    """The k-th call as a loop makes it, on memory that is there: state at the box's corner, u(x) = x, D_hat random."""
    n, m, lanes = job.plant.n, job.plant.m, entry.batch
    X = np.tile(box(job.plant, job.config.generate)[:, :1], (1, lanes))
    u = np.tile(grid.nodes(entry.nx)[:, None, None], (1, m, lanes))
    drawn = randomness.generator(job.config.seed, "bench").uniform(0.5, 1.7, count + lanes - 1)
    D_hat = np.lib.stride_tricks.sliding_window_view(drawn, lanes, writeable=True)  # (count, lanes), in little memory
    if entry.copies is False:
        return _resident(entry, X.T, u.transpose(2, 0, 1), D_hat)
    P, delays = np.empty((entry.nx, n, lanes)), np.empty(lanes)
    predict = bound(entry.run.lanes(), X, u, delays, 0.0, job.plant.p, P)

    def one(k: int) -> None:
        delays[:] = D_hat[k]
        predict()

    numbers, delay = drawn.tolist(), ctypes.c_double.from_address(address(delays))

    def alone(k: int) -> None:  # NumPy would take longer for one number than a method of few steps
        delay.value = numbers[k]
        predict()

    return alone if lanes == 1 else one


def _resident(entry: Candidate, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray) -> Callable[[int], None]:
    """The call on data in a GPU's memory, up to the end of its work."""
    import torch

    operator: Any = getattr(entry.run, "operator")  # noqa: B009 - a network's predictor has one
    phase = (np.zeros(len(X)),) if entry.run.plant.phased else ()
    tensors = [torch.as_tensor(np.array(a), dtype=torch.float32, device=entry.device) for a in (X, u, D_hat, *phase)]

    @torch.inference_mode()
    def one(k: int) -> None:
        operator(tensors[0], tensors[1], tensors[2][k], *tensors[3:])
        torch.cuda.synchronize(entry.device)

    return one
