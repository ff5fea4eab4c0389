"""Closed loops of plant, actuator, predictor and delay adaptation, simulated side by side [DAPF, eqs. 6-14]."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from npred.base import array_checks, devices
from npred.base.errors import ConfigError
from npred.base.progress import announce, counted, quiet
from npred.estimation import delay_law
from npred.estimation.delay_law import DelayLaw, Part, part
from npred.loop import clocked, engine, loop_checks, signals
from npred.loop import measurement as sensing
from npred.loop.actuator import history
from npred.loop.clocked import Clocked
from npred.loop.engine import Engine
from npred.loop.loop import HISTORY, Loop, LoopParts
from npred.loop.signals import Record, Settings, State
from npred.loop.trajectories import Samples, Trajectories, of_record
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.delays.constant import ConstantDelay
from npred.prediction.methods import RK4, OneStep, Predictor

__all__ = ["Samples", "Trajectories", "simulate"]

LANES = 64  # loops per chunk: with more, their memory leaves the second-level cache
NEURAL_LANES = 512  # a network's call has a fixed cost to share
FIRST, BLOCK = 10, 500  # control steps before the first report of progress, and between two of them


def simulate(
    plant: Plant, predictor: Predictor | None, *, X0: Any, t_end: float, D: Any = None, D_hat: Any = None,
    dt: float = 0.005, adaptation: DelayLaw | None = None, every: int = 1, samples: ArrayLike | None = None,
    progress: Callable[[int], Any] | bool | None = None, **parts: Unpack[LoopParts],
) -> Trajectories:  # fmt: skip
    """Loops of X' = f(X, U(t - D)), U = kappa(P(1)), D_hat' = gamma Proj{D_hat, phi} [DAPF, eqs. 6-14].

    D, D_hat and X0 broadcast to the batch. Where inputs have several delays input j comes after r_j D, and U_j =
    kappa_j(P(r_j), t + r_j D_hat). A DelayLaw that you write runs in Python. If a loop overflows, the rest of it is
    NaN; the other loops are not affected. Where commands would overtake each other, a loop of a plant that declares its
    delay is marked (`infeasible`) and ends.

    Without a predictor the loop is open, U = 0. With D_hat = 0 there is no prediction, U = kappa(X, t). A plant that
    declares its delay takes no other D_hat.

    With `timing`, `observer` or `watchdog` the loops run on a real clock, one after the other: npred.controller with
    actuator="history" is called at its own times, and samples and commands have theirs, not rounded to control steps. X
    is that of k dt all the same; `clock` has what the controller says besides (npred.loop.trajectories.OnAClock).

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    predictor : Predictor or None
        From npred.predictor, npred.load or npred.guarded; None is the open loop U = 0.
    X0 : array (..., n), in the plant's units
        States at t = 0.
    t_end : float, in the plant's unit of time
        Length of the loops.
    D : array (...) or function of t, in the plant's unit of time, optional
        True delay, where inputs have several the longest. A function is a delay that drifts or jumps. None for a
        plant that declares its delay.
    D_hat : array (...), in the plant's unit of time, optional
        Estimate of the delay; None for a plant that declares it.
    dt : float, in the plant's unit of time, default 0.005
        Control step; U is held over it.
    adaptation : DelayLaw or None, optional
        Law of the estimate D_hat; None freezes it.
    every : int, default 1
        Control steps between two kept states.
    samples : int array (..., S), optional
        Control steps, sorted, of which (X, u, D_hat) are kept too.
    progress : bool or function, optional
        True shows a bar, in a terminal or a notebook; a function gets the number of loop steps done; by default a
        line on stderr says so if loops take longer than a second.
    **parts
        The other parts of npred.Loop: input_bounds, u0, actuator, measurement, truth, disturbance, safety, integrator, timing, observer, watchdog,
        outlier_limit, max_sample_age.

    Returns
    -------
    Trajectories
        Closed loops: t (nt,) in seconds, X and P (..., nt, n), U (..., nt, m), D_hat, N and energy (..., nt).

    Raises
    ------
    ConfigError
        For delays, bounds, times, shapes or a predictor that do not fit, and for an unknown part.
    """
    named = {"plant": plant, "predictor": predictor, "D": D, "D_hat": D_hat, "X0": X0, "dt": dt}
    loop = Loop.of("simulate", ("history_length",), named | {"adaptation": adaptation, **parts})
    return run(loop, t_end, every, samples, progress)


def run(
    loop: Loop, t_end: float, every: int = 1, samples: ArrayLike | None = None,
    progress: Callable[[int], Any] | bool | None = None,
) -> Trajectories:  # fmt: skip
    """Simulate a loop over t_end; see `simulate`."""
    plant, dt, D_hat, adaptation = loop.plant, loop.dt, loop.D_hat, loop.adaptation
    loop_checks.parts(plant, loop.predictor, adaptation, every)
    if loop.safety is not None:
        loop_checks.protected(plant, loop.safety, dt)
    loop_checks.reality(loop)
    on_a_clock = any(part is not None for part in (loop.timing, loop.observer, loop.watchdog))
    if on_a_clock:
        clocked.check(loop)
    loop_checks.times(t_end, dt, loop.measurement)
    loop_checks.record(plant, 1, t_end, dt, every)
    X0, truth = array_checks.floats("X0", loop.X0), loop.real
    blind, D = plant.declares_delay and D_hat is not None, loop.D
    if plant.declares_delay:
        loop_checks.start(plant, X0)
        D, D_hat = _declared(truth, X0), D_hat if blind else _declared(plant, X0)
    table = _tabulated(D, t_end, dt) if callable(D) else None
    D, D_hat = (array_checks.floats(name, a) for name, a in (("D", D if table is None else table[0]), ("D_hat", D_hat)))
    loop_checks.start(plant, X0)
    array_checks.delays("D", D)
    array_checks.delays("D_hat", D_hat)
    loop_checks.one_per_loop(plant, D, X0)
    if adaptation is not None:
        delay_law.resolved("dt", dt, D)
        adaptation = adaptation.suited(plant, D if table is None else table, D_hat)
        array_checks.within("D_hat", D_hat, adaptation.bounds, plant.time_unit)
    shape = array_checks.batch(X0=X0.shape[:-1], D=D.shape, D_hat=D_hat.shape)
    if 0 in shape:
        raise ConfigError(f"X0, D, D_hat: expected at least one loop, got a batch of shape {shape}; give one a start")
    X0 = np.broadcast_to(X0, (*shape, plant.n)).reshape(-1, plant.n)
    D, D_hat = (np.broadcast_to(a, shape).reshape(-1) for a in (D, D_hat))
    delays = np.zeros((0, len(D)))
    if table is not None:
        padded = table.reshape(len(table), *(1,) * (len(shape) - table.ndim + 1), *table.shape[1:])
        delays = np.broadcast_to(padded, (len(table), *shape)).reshape(-1, len(D))
    loop_checks.record(plant, len(D), t_end, dt, every)
    sample_steps = loop_checks.samples(samples, shape, round(t_end / dt))
    method = loop_checks.integrator(loop.integrator, plant, truth)
    limits = inputs.bounds(plant, loop.input_bounds)
    past = inputs.past(plant, loop.u0, limits, X0, D)
    loop = replace(loop, D=D, D_hat=D_hat, X0=X0, adaptation=adaptation, input_bounds=limits)
    one = _Simulation(loop, round(t_end / dt) + 1, every, method, shape, blind)
    loop_checks.history(plant, one.reach(D, D_hat, delays)[1], dt)
    with quiet() if progress is False else nullcontext():
        engine.prepare(one.parts)
    clock = None
    with _counted(progress, len(D), one.count) as count:
        if on_a_clock:
            joined, clock = Clocked(loop, one.count, every, one.parts["advance"], one.pushes).run(
                past, sample_steps, delays, one.compiled, count
            )
        else:
            width = LANES if one.compiled else NEURAL_LANES
            chunks = [slice(i, min(i + width, len(D))) for i in range(0, len(D), width)]
            records = [one.run(c, past.of(c), sample_steps[c], delays[:, c], count) for c in chunks]
            joined = Record(*(np.concatenate(parts, axis=-1) for parts in zip(*records, strict=True)))
    ends = adaptation.ends(dt) if adaptation and loop.predictor else None
    return of_record(joined, shape, dt * every, one.count, plant, truth, loop.predictor, ends, clock)


def _declared(plant: Plant, X0: np.ndarray) -> np.ndarray:
    """D(X0, 0), (...)."""
    X = np.array(X0.reshape(-1, plant.n).T, order="C")
    D_hat, D = np.empty(X.shape[1]), np.empty((plant.m, X.shape[1]))
    horizon = problem_of(plant).horizon()
    assert horizon is not None
    horizon(X, 0.0, plant.p, plant.ratios, D_hat, D)
    return D_hat.reshape(X0.shape[:-1])


def _tabulated(D: Callable[[float], Any], t_end: float, dt: float) -> np.ndarray:
    """D(t) at the control steps and one further, (steps + 1, ...)."""
    values = [array_checks.floats("D(t)", D(k * dt)) for k in range(round(t_end / dt) + 2)]
    array_checks.batch(**{f"D({k * dt:g})": value.shape for k, value in enumerate(values)})
    table = np.stack(np.broadcast_arrays(*values))
    array_checks.delays("D(t)", table)
    return table


@contextmanager
def _counted(
    progress: Callable[[int], Any] | bool | None, loops: int, steps: int
) -> Iterator[Callable[[int], Any] | None]:  # fmt: skip
    """A function of the number of loop steps done: a bar where `progress` is True, a line where it is not said."""
    if progress is None:
        with announce(f"simulating {counted(loops, 'loops')}", total=loops * steps) as work:
            yield work.advance
    elif progress is True:
        from tqdm.auto import tqdm

        with tqdm(total=loops * steps, unit="step", unit_scale=True) as bar:
            yield bar.update
    else:
        yield progress or None


def compiled(plant: Plant, predictor: Predictor | None, law: Part) -> bool:
    """True if the controller's parts are kernels, which let go of the interpreter."""
    return plant.traced and law.compiled and (predictor is None or predictor.compiled)


@dataclass(frozen=True)
class _Simulation:
    """The parts that all chunks of one simulation share; `loop` has nothing left to be filled in."""

    loop: Loop
    count: int  # control steps, that at t = 0 included
    every: int
    integrator: type[OneStep]
    shape: tuple[int, ...]  # of the batch
    blind: bool  # whether the controller of a plant that declares its delay is as if there was none

    @cached_property
    def law(self) -> Part:
        """The kernels of U and of D_hat's rate; the open loop has U = 0."""
        if self.loop.predictor is None:
            return part(self.loop.plant, None, self.loop.dt)._replace(control=None)
        law = part(self.loop.plant, self.loop.adaptation, self.loop.dt)
        return law._replace(control=ConstantDelay(self.loop.plant).control(RK4.step)) if self.blind else law

    @cached_property
    def pushes(self) -> np.ndarray:
        """The disturbance in the middle of each control step, (steps, m, 1 or B), or (0, m, 0) without one."""
        m = self.loop.plant.m
        if self.loop.disturbance is None:
            return np.zeros((0, m, 0))
        times = (np.arange(self.count) + 0.5) * self.loop.dt
        values = [loop_checks.push(self.loop.disturbance(t), m, self.shape) for t in times.tolist()]
        return np.moveaxis(np.stack(np.broadcast_arrays(*values)), 1, 2)

    @property
    def reads_commands(self) -> bool:
        """True if the controller reads u from its own commands."""
        return self.loop.actuator == HISTORY

    @property
    def compiled(self) -> bool:
        """True if all parts are kernels; else the loop calls those in Python, and needs the interpreter."""
        controller = compiled(self.loop.plant, self.loop.predictor, self.law)
        return controller and self.loop.real.traced and self.loop.measurement.observer is None

    def run(self, c: slice, past: inputs.Past, samples: np.ndarray, delays: np.ndarray, progress: Any) -> Record:
        """One chunk of the loops, with the inputs of t < 0, samples (B, S) and delays (steps + 1 or 0, B)."""
        X0, D, D_hat = self.loop.X0[c], self.loop.D[c], self.loop.D_hat[c]
        lanes, nx = len(D), 2 if self.loop.predictor is None else self.loop.predictor.nx
        origin, held, total = history(*self.reach(D, D_hat, delays), self.loop.dt, past)
        state = self._state(X0, D, D_hat, held, total, nx)
        rows = (self.count - 1) // self.every + 1
        settings = self._settings(samples, delays, c.start, rows)
        n, m = self.loop.plant.n, self.loop.plant.m
        sizes = {"n": n, "m": m, "nx": nx, "row": rows, "sample": samples.shape[1] + 1, "breach": n + m + 1}
        out = Record(**signals.memory(signals.RECORD, sizes, lanes, {}))
        steps = Engine(self.parts, settings, state, out)
        if progress:
            progress(0)
        for start, stop in pairwise([0, *range(min(FIRST, self.count), self.count, BLOCK), self.count]):
            with devices.one_thread():
                steps.run(origin, start, stop)
            if progress:
                progress((stop - start) * lanes)
        return out

    def reach(self, D: np.ndarray, D_hat: np.ndarray, delays: np.ndarray) -> tuple[float, float]:
        """How far back commands may be read, in seconds: before t = 0, and at any time."""
        spans = [D.max(), delays.max(initial=0.0)]
        if self.reads_commands or self.law.memory > 1 or self.loop.plant.declares_delay:
            spans += [D_hat.max(), self.law.bounds[1] if self.loop.adaptation else 0.0]
        before = float(max(spans)) + self.loop.measurement.delay
        longest = (self.count - 1) * self.loop.dt
        return before, before + (longest if self.loop.plant.declares_delay else 0.0)  # phi(t) = t - D only rises

    @cached_property
    def parts(self) -> dict[str, Any]:
        """The sentences of a control step, on lanes, traced once for all chunks."""
        model = ConstantDelay(self.loop.plant) if self.blind else problem_of(self.loop.plant)
        truth, law = problem_of(self.loop.real), self.law
        observer = self.loop.measurement.observer
        return {
            "horizon": truth.horizon(),
            "observer": observer and sensing.observed(observer),
            "observe": law.observe,
            "model_delay": model.horizon(),  # None too where D_hat = 0
            "predict": self.loop.predictor and (model.sweep(RK4.step) if self.blind else self.loop.predictor.lanes()),
            "guard": None if self.blind else getattr(self.loop.predictor, "guard", None),
            "control": law.control,
            "update": law.update,
            "delay_speed": truth.speed(),
            "advance": engine.advance_kernel(self.loop.real, self.integrator),
            **engine.protection(self.loop.safety, self.loop.predictor),
            "model": None if self.loop.measurement.perfect else engine.advance_kernel(self.loop.plant, self.integrator),
        }

    def _settings(self, samples: np.ndarray, delays: np.ndarray, first: int, rows: int) -> Settings:
        plant, m, settings = self.loop.plant, self.loop.plant.m, getattr(self.loop.predictor, "settings", None)
        pushes = self.pushes if self.pushes.shape[2] < 2 else self.pushes[..., first : first + len(samples)]
        return signals.settings(
            dt=self.loop.dt,
            b=self.law.b,
            gamma_dt=self.law.gamma * self.loop.dt,
            every=self.every,
            row_count=rows,
            sample_count=samples.shape[1],
            late=round(self.loop.measurement.delay / self.loop.dt) if self.loop.measurement.observer is None else 0,
            reads_commands=self.reads_commands,
            stores_commands=True,
            moves=self.loop.real.declares_delay,
            senses=not self.loop.measurement.perfect,
            tabulates=len(delays) > 0,
            disturbed=pushes.shape[2],
            bounds=self.law.bounds,
            input_bounds=np.ascontiguousarray(self.loop.input_bounds, dtype=float),
            u_star=np.ascontiguousarray(plant.u_equilibrium if plant.rests else np.zeros(m), dtype=float),
            p=self.loop.plant.p,
            truth_p=self.loop.real.p,
            ratios=self.loop.plant.ratios,
            law=self.law.settings,
            guard=np.zeros(0) if settings is None else settings,
            delays=np.array(delays[:, None, :] * self.loop.plant.ratios[:, None], order="C"),
            disturbance=np.ascontiguousarray(pushes),
            samples=np.array(samples.T, order="C", dtype=np.int64),
            **(self.loop.safety.settings(self.loop.dt, self.loop.input_bounds) if self.loop.safety else {}),
            **sensing.settings(self.loop.measurement, self.loop.dt, first, self.loop.plant.n),
        )

    def _state(
        self, X0: np.ndarray, D: np.ndarray, D_hat: np.ndarray, held: np.ndarray, total: np.ndarray, nx: int
    ) -> State:
        n, m, lanes, D = self.loop.plant.n, self.loop.plant.m, len(D), self.loop.plant.ratios[:, None] * D
        X, age = np.array(X0.T, order="C"), round(self.loop.measurement.delay / self.loop.dt)
        reads_commands = self.reads_commands or (self.loop.plant.declares_delay and not self.blind)
        arrays = {"X": X, "D": D, "D_hat": np.array(D_hat), "held": held, "total": total}
        arrays |= {"D_seen": D.copy() if reads_commands else D}
        arrays |= {"X_hat": X, "Y": X} if self.loop.measurement.perfect else {"X_hat": X.copy()}
        sizes = {"n": n, "m": m, "nx": nx, "observer": self.law.memory, "past": age + 1}
        sizes |= dict.fromkeys(("clock", "outputs", "filter", "ends", "protected"), 0)
        sizes |= self.loop.safety.sizes(nx) if self.loop.safety else {}
        return State(**signals.memory(signals.STATE, sizes, lanes, arrays))
