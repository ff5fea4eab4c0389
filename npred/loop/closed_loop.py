"""Closed loops of plant, actuator, predictor and delay adaptation, simulated side by side [DAPF, eqs. 6-14]."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from npred import array_checks
from npred.delays import family
from npred.errors import ConfigError
from npred.loop import actuator, engine, loop_checks, trajectory_views
from npred.loop.delay_law import DelayLaw, Part, part
from npred.plants import inputs
from npred.plants.base import Plant
from npred.predictors import Compiled, OneStep, Predictor

LANES = 64  # loops per chunk: with more, their memory leaves the second-level cache
NEURAL_LANES = 512  # a network's call has a fixed cost to share
LOOPS = ("X", "U", "D_hat", "N", "energy", "escaped", "P")  # of Trajectories: arrays whose first axes are the batch
BLOCK = 500  # control steps between two reports of progress


@dataclass(frozen=True)
class Samples:
    """(X, u, D_hat) of each loop at chosen steps: X (..., S, n), u (..., S, nx, m), D_hat (..., S)."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray


@dataclass(frozen=True, repr=False)
class Trajectories:
    """Closed loops: t (nt,) in seconds, X and P (..., nt, n), U (..., nt, m), D_hat, N and energy (..., nt).

    P is the prediction at x = 1, P(1, t), for X(t + D_hat); NaN in the open loop.
    N = 1 + V + b ∫₀¹ (1+x) w² dx, NaN without adaptation; energy = ∫_{t-D}^t |U - U*|² ds; see npred.loop.lyapunov.
    `escaped` (...) is the first step whose state is not finite, or -1; `states`, `inputs`, `time_unit`, `labels` and
    `units` are the plant's. print(loop) gives the ranges and ends of all series.
    """

    t: np.ndarray
    X: np.ndarray
    U: np.ndarray
    D_hat: np.ndarray
    N: np.ndarray
    energy: np.ndarray
    escaped: np.ndarray
    samples: Samples
    P: np.ndarray
    states: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    time_unit: str = "s"
    labels: Mapping[str, str] | None = None
    units: Mapping[str, str] | None = None

    def __repr__(self) -> str:
        return trajectory_views.summary(self)

    def plot(self, D: Any = None) -> Any:
        """States, inputs and D_hat over time, a panel each, all loops in each; `D` (...) adds the true delay, dashed.

        Gives matplotlib's axes (n + m + 1,); their figure is `axes[0].figure`, shown by matplotlib.pyplot.show().
        """
        return trajectory_views.plot(self, D)

    def to_dataframe(self) -> Any:
        """A pandas DataFrame: a row per kept time, a column per state and input, and D_hat; the index is t in seconds.

        A batch's index has the loop's number along each axis before t. A name that stands twice gets its letter in
        front, as `X.h` and `U.h`. Raises MissingError where pandas is not installed.
        """
        return trajectory_views.dataframe(self)

    def part(self, rows: slice) -> "Trajectories":
        """The loops `rows` of a batch with one axis."""
        cut = {name: getattr(self, name)[rows] for name in LOOPS}
        taken = {f.name: getattr(self.samples, f.name)[rows] for f in fields(Samples)}
        return replace(self, samples=Samples(**taken), **cut)

    @classmethod
    def joined(cls, parts: Sequence["Trajectories"]) -> "Trajectories":
        """The loops of several batches of one axis and the same times, one batch after the other."""

        def join(of: Sequence[Any], names: Sequence[str]) -> dict[str, np.ndarray]:
            return {name: np.concatenate([getattr(part, name) for part in of]) for name in names}

        samples = Samples(**join([part.samples for part in parts], [f.name for f in fields(Samples)]))
        return replace(parts[0], samples=samples, **join(parts, LOOPS))


def simulate(
    plant: Plant,
    predictor: Predictor | None,
    *,
    D: Any,
    D_hat: Any,
    X0: Any,
    t_end: float,
    dt: float = 0.005,
    adaptation: DelayLaw | None = None,
    input_bounds: Any = None,
    u0: Any = None,
    every: int = 1,
    samples: np.ndarray | None = None,
    integrator: str = "rk4",
    progress: Callable[[int], Any] | bool | None = None,
) -> Trajectories:
    """Loops of X' = f(X, U(t - D)), U = kappa(P(1)), D_hat' = gamma Proj{D_hat, phi} [DAPF, eqs. 6-14].

    D, D_hat (...) in seconds and X0 (..., n) broadcast to the batch. Where inputs have several delays D is the
    longest, input j comes after r_j D, and U_j = kappa_j(P(r_j), t + r_j D_hat). U is held over each step of dt and
    clipped to `input_bounds` (m, 2), by default the plant's. Before t = 0 the input is u0: numbers (m,), "equilibrium"
    or "law", kappa(X0, 0); by default 0 where the bounds allow it, else the equilibrium's. `predictor=None` is the open
    loop U = 0, `adaptation=None` freezes D_hat; a DelayLaw that you write runs in Python. Every `every`-th step
    is kept; `samples` (..., S) are sorted steps whose (X, u, D_hat) are kept too. `integrator` advances the plant.
    `progress=True` shows a bar of the loop steps done, in a terminal or a notebook; a function gets their number.
    A loop that leaves the finite numbers goes on as NaN and leaves the others alone.
    Raises ConfigError for delays, bounds, times, shapes or a predictor that do not fit.
    """
    loop_checks.parts(plant, predictor, adaptation, every)
    X0, D, D_hat = (array_checks.floats(name, a) for name, a in (("X0", X0), ("D", D), ("D_hat", D_hat)))
    loop_checks.numbers(plant, X0, D, D_hat, t_end, dt, adaptation)
    shape = array_checks.batch(X0=X0.shape[:-1], D=D.shape, D_hat=D_hat.shape)
    if 0 in shape:
        raise ConfigError(f"X0, D, D_hat: expected at least one loop, got a batch of shape {shape}; give one a start")
    X0 = np.broadcast_to(X0, (*shape, plant.n)).reshape(-1, plant.n)
    D, D_hat = (np.broadcast_to(a, shape).reshape(-1) for a in (D, D_hat))
    loop_checks.room(plant, D, t_end, dt, every)
    sample_steps = loop_checks.samples(samples, shape, round(t_end / dt))
    limits, method = inputs.bounds(plant, input_bounds), loop_checks.integrator(integrator)
    held = inputs.before(plant, u0, limits, X0)
    loop = _Simulation(plant, predictor, adaptation, limits, dt, t_end, every, method)
    width = LANES if loop.compiled else NEURAL_LANES
    chunks = [slice(i, i + width) for i in range(0, len(D), width)]
    with _counted(progress, len(D) * (round(t_end / dt) + 1)) as count:
        records = [loop.run(X0[c], D[c], D_hat[c], held[c], sample_steps[c], count) for c in chunks]
    joined = engine.Record(*(np.concatenate(parts, axis=-1) for parts in zip(*records, strict=True)))
    return _trajectories(joined, shape, dt * every, plant)


@contextmanager
def _counted(progress: Callable[[int], Any] | bool | None, total: int) -> Iterator[Callable[[int], Any] | None]:
    """A function of the number of loop steps done, of `total`: a bar where `progress` is True."""
    if isinstance(progress, bool) or progress is None:
        if not progress:
            yield None
            return
        from tqdm.auto import tqdm

        with tqdm(total=total, unit="step", unit_scale=True) as bar:
            yield bar.update
    else:
        yield progress


@dataclass(frozen=True)
class _Simulation:
    """The parts that all chunks of one simulation share."""

    plant: Plant
    predictor: Predictor | None
    adaptation: DelayLaw | None
    input_bounds: np.ndarray
    dt: float
    t_end: float
    every: int
    integrator: type[OneStep]

    @cached_property
    def law(self) -> Part:
        """The kernels of U and of D_hat's rate; the open loop has U = 0."""
        if self.predictor is None:
            return part(self.plant, None)._replace(control=family.idle(family.CONTROL))
        return part(self.plant, self.adaptation)

    @property
    def compiled(self) -> bool:
        """True if all parts are kernels; else the same loop runs in Python around those that are."""
        parts = self.plant.traced and self.law.compiled
        return parts and (self.predictor is None or isinstance(self.predictor, Compiled))

    def run(
        self, X0: np.ndarray, D: np.ndarray, D_hat: np.ndarray, u0: np.ndarray, samples: np.ndarray, progress: Any
    ) -> engine.Record:
        """Simulate one chunk of loops: X0 (B, n), D and D_hat (B,), u0 (B, m), samples (B, S)."""
        lanes, nx = len(D), 2 if self.predictor is None else self.predictor.nx
        count = round(self.t_end / self.dt) + 1
        origin, state = self._state(X0, D, D_hat, u0, nx)
        settings, out = self._settings(samples), self._record(count, samples.shape[1], nx, lanes)
        parts = self._parts()
        steps = engine.compiled_steps if self.compiled else engine.steps
        for start in range(0, count, BLOCK):
            stop = min(start + BLOCK, count)
            with np.errstate(all="ignore"):  # a loop that leaves the finite numbers is NaN from there on
                steps(origin, start, stop, *parts, settings, state, out)
            if progress:
                progress((stop - start) * lanes)
        return out

    def _parts(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """The six sentences of a control step, on lanes."""
        advance = engine.advance_kernel(self.plant, self.integrator)
        predict = family.idle(family.PREDICT) if self.predictor is None else self.predictor.lanes()
        return actuator.transport, predict, self.law.control, self.law.update, actuator.actuate, advance

    def _settings(self, samples: np.ndarray) -> engine.Settings:
        return engine.Settings(
            dt=self.dt,
            every=self.every,
            b=self.law.b,
            gamma_dt=self.law.gamma * self.dt,
            bounds=self.law.bounds,
            input_bounds=self.input_bounds,
            u_star=self.plant.u_equilibrium if self.plant.rests else np.zeros(self.plant.m),
            p=self.plant.p,
            samples=np.array(samples.T, order="C"),
        )

    def _state(
        self, X0: np.ndarray, D: np.ndarray, D_hat: np.ndarray, u0: np.ndarray, nx: int
    ) -> tuple[int, engine.State]:
        n, m, lanes, D = self.plant.n, self.plant.m, len(D), self.plant.ratios[:, None] * D
        origin, held, total = actuator.history(D, self.dt, u0.T)
        state = engine.State(
            X=np.array(X0.T, order="C"), D=D, D_hat=np.array(D_hat), held=held, total=total,
            u=np.empty((nx, m, lanes)), u_nodes=np.empty((nx, m, lanes)), P=np.full((nx, n, lanes), np.nan),
            U=np.zeros((m, lanes)), phi=np.zeros(lanes), phi_before=np.full(lanes, np.nan), N=np.full(lanes, np.nan),
            U0=np.empty((m, lanes)), U1=np.empty((m, lanes)), share=np.empty((m, lanes)),
            drawn=np.zeros(lanes, dtype=np.int64),
        )  # fmt: skip
        return origin, state

    def _record(self, count: int, samples: int, nx: int, lanes: int) -> engine.Record:
        n, m, rows = self.plant.n, self.plant.m, (count - 1) // self.every + 1
        series = {"X": (rows, n), "P": (rows, n), "U": (rows, m), "D_hat": (rows,), "N": (rows,), "energy": (rows,)}
        taken = {"sample_X": (samples, n), "sample_u": (samples, nx, m), "sample_D_hat": (samples,)}
        arrays = {name: np.full((*shape, lanes), np.nan) for name, shape in (series | taken).items()}
        return engine.Record(**arrays, escaped=np.full(lanes, -1, dtype=np.int64))


def _trajectories(r: engine.Record, shape: tuple[int, ...], step: float, plant: Plant) -> Trajectories:
    def lead(a: np.ndarray) -> np.ndarray:
        """Lanes last to the batch's shape first."""
        return np.moveaxis(a, -1, 0).reshape((*shape, *a.shape[:-1]))

    samples = Samples(lead(r.sample_X), lead(r.sample_u), lead(r.sample_D_hat))
    series = {name: lead(getattr(r, name)) for name in LOOPS}
    times = np.arange(len(r.X)) * step
    return Trajectories(
        t=times, samples=samples, states=plant.states, inputs=plant.inputs, time_unit=plant.time_unit,
        labels=plant.labels, units=plant.units, **series,
    )  # fmt: skip
