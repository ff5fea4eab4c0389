"""One simulation: the parts of a control step on lanes, and chunks of loops that run side by side."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from npred.base import devices
from npred.estimation.delay_law import Part
from npred.loop import assembly, engine, loop_checks, settable, signals
from npred.loop import measurement as sensing
from npred.loop.actuator import history
from npred.loop.engine import Engine
from npred.loop.loop import Loop
from npred.loop.signals import Record, Settings, State
from npred.loop.timing import SNAP, on_steps
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4, OneStep, Predictor

LANES = 64  # loops per chunk: with more, their memory leaves the second-level cache
NEURAL_LANES = 512  # a network's call has a fixed cost to share
FIRST, BLOCK = 10, 500  # control steps before the first report of progress, and between two of them


def compiled(plant: Plant, predictor: Predictor | None, law: Part) -> bool:
    """True if the controller's parts are kernels, which let go of the interpreter."""
    return plant.traced and law.compiled and (predictor is None or predictor.compiled)


@dataclass(frozen=True)
class Simulation:
    """Loops of B lanes; `loop` has nothing left to be filled in, its D is (B,), its X0 is (B, n)."""

    loop: Loop
    count: int  # control steps, that at t = 0 included
    every: int
    integrator: type[OneStep]
    shape: tuple[int, ...]  # the axes of the batch
    D_hat: np.ndarray  # (B,), the first estimates; those of `loop` are None where the plant declares its delay
    past: inputs.Past  # the inputs of t < 0
    samples: np.ndarray  # (B, S), the steps that are kept too
    delays: np.ndarray  # (count + 1, B), or (0, B) where D is no function of time

    @cached_property
    def law(self) -> Part:
        """The kernels of U and of D_hat's rate; the open loop has U = 0."""
        return assembly.law(self.loop)

    @cached_property
    def course(self) -> list[settable.Piece]:
        """The set-points, the declared one first."""
        loop = self.loop
        if not loop.setpoints or loop.predictor is None:
            return [settable.Piece(-math.inf, loop.plant.p, {})]
        cannot, bounds = settable.fixed(loop.plant, loop.predictor), inputs.widest(loop.plant, loop.input_bounds)
        return settable.course(loop.plant, loop.setpoints, cannot, bounds)

    @cached_property
    def begins(self) -> dict[int, settable.Piece]:
        """The pieces after the first by the control step at which they begin; of several at one step the last."""
        starts = [(max(math.ceil(piece.start / self.loop.dt - SNAP), 0), piece) for piece in self.course[1:]]
        return {k: piece for k, piece in starts if k < self.count}

    def begin(self, k: int, settings: Settings) -> None:
        """Set in these settings what is set at control step k."""
        if piece := self.begins.get(k):
            plant, names = self.loop.plant, list(self.loop.real.parameters)
            settings.p[:] = piece.p
            for name, value in piece.values.items():
                if name in names:
                    settings.truth_p[names.index(name)] = value
            if plant.rests and settings.u_star.size:
                settings.u_star[:] = piece.target(plant, np.array([k * self.loop.dt]))[1][0]

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
    def compiled(self) -> bool:
        """True if all parts are kernels; else the loop calls those in Python, and needs the interpreter."""
        controller = compiled(self.loop.plant, self.loop.predictor, self.law)
        return controller and self.loop.real.traced and self.loop.measurement.observer is None

    def run(self, progress: Any) -> Record:
        """All loops, chunk by chunk."""
        lanes, width = len(self.loop.D), LANES if self.compiled else NEURAL_LANES
        records = [self._chunk(slice(i, min(i + width, lanes)), progress) for i in range(0, lanes, width)]
        return signals.joined(records)

    def _chunk(self, c: slice, progress: Any) -> Record:
        lanes = c.stop - c.start
        origin, held, total = history(*self.reach(c), self.loop.dt, self.past.of(c))
        settings = self.settings(c)._replace(stores_commands=1, gated=int(self.refuses))
        out = self.record(lanes, self.samples.shape[1])
        state = self._state(c, held, total)
        steps = Engine(self.parts, settings, state, out)
        if progress:
            progress(0)
        stops = {0, *range(min(FIRST, self.count), self.count, BLOCK), self.count, *self.begins}
        for start, stop in pairwise(sorted(stops)):
            self.begin(start, settings)
            with devices.one_thread():
                steps.run(origin, start, stop)
            if progress:
                progress((stop - start) * lanes)
        if self.law.memory > 1:
            out.D_hat_spread[:] = engine.spreads(self.loop.plant.m, settings.law, state.observer, state.D_hat)
        return out

    @property
    def rows(self) -> int:
        """The number of kept control steps."""
        return (self.count - 1) // self.every + 1

    def record(self, lanes: int, samples: int) -> Record:
        """An empty record."""
        sizes = assembly.sizes(self.loop, self.law)
        sizes |= {"row": self.rows, "sample": samples + 1, "breach": sizes["n"] + sizes["m"] + 1}
        return Record(**signals.memory(signals.RECORD, sizes, lanes, {}))

    def reach(self, c: slice) -> tuple[float, float]:
        """How far back the commands of some loops may be read: before t = 0, and at any time."""
        loop, spans = self.loop, [self.loop.D[c].max(), self.delays[:, c].max(initial=0.0)]
        if loop.reads_commands or self.law.memory > 1 or loop.plant.declares_delay:
            spans += [self.D_hat[c].max(), self.law.bounds[1] if loop.adaptation else 0.0]
        before = float(max(spans)) + loop.measurement.delay
        longest = (self.count - 1) * loop.dt
        return before, before + (longest if loop.plant.declares_delay else 0.0)  # phi(t) = t - D only rises

    @cached_property
    def parts(self) -> dict[str, Any]:
        """The sentences of a control step, traced once: the controller's, and the simulated plant's."""
        truth, observer = problem_of(self.loop.real), self.loop.measurement.observer
        return assembly.kernels(self.loop, self.law) | {
            "horizon": truth.horizon(),
            "observer": observer and sensing.observed(observer),
            "delay_speed": truth.speed(),
            "advance": engine.advance_kernel(self.loop.real, self.integrator),
        }

    @property
    def refuses(self) -> bool:
        """Whether some sample may be far from what the model expects: else there is nothing to judge."""
        loop = self.loop
        if not loop.reads_commands or loop.outlier_limit is None or loop.measurement.observer is not None:
            return False
        knows_D = loop.plant.declares_delay or (loop.adaptation is None and np.array_equal(loop.D, self.D_hat))
        exact = knows_D and not loop.blind and not len(self.delays) and loop.integrator == RK4.name
        exact = exact and loop.truth is None and loop.disturbance is None and not loop.setpoints
        return not (exact and loop.measurement.perfect) and on_steps(loop.measurement, loop.dt)

    @cached_property
    def _settings(self) -> Settings:
        loop, plant = self.loop, self.loop.plant
        return assembly.settings(
            loop,
            self.law,
            every=self.every,
            row_count=self.rows,
            sample_count=self.samples.shape[1],
            late=round(loop.measurement.delay / loop.dt) if loop.measurement.observer is None else 0,
            moves=loop.real.declares_delay,
            senses=not loop.measurement.perfect,
            tabulates=len(self.delays) > 0,
            u_star=np.array(plant.u_equilibrium if plant.rests else np.zeros(plant.m), dtype=float),
        )

    def settings(self, c: slice) -> Settings:
        """The settings of some loops, of the controller and of what is simulated; those that are set are copies."""
        loop, of, delays = self.loop, self._settings, self.delays[:, c]
        pushes = self.pushes if self.pushes.shape[2] < 2 else self.pushes[..., c]
        return of._replace(
            p=of.p.copy(),
            truth_p=of.truth_p.copy(),
            u_star=of.u_star.copy(),
            disturbed=pushes.shape[2],
            delays=np.array(delays[:, None, :] * loop.plant.ratios[:, None], order="C"),
            disturbance=np.ascontiguousarray(pushes),
            samples=np.array(self.samples[c].T, order="C", dtype=np.int64),
            **sensing.settings(loop.measurement, loop.dt, c.start, len(assembly.outputs(loop))),
        )

    def _state(self, c: slice, held: np.ndarray, total: np.ndarray) -> State:
        loop, plant = self.loop, self.loop.plant
        X, D = np.array(loop.X0[c].T, order="C"), plant.ratios[:, None] * loop.D[c]
        reads_commands = loop.reads_commands or (plant.declares_delay and not loop.blind)
        arrays = {"X": X, "D": D, "D_hat": np.array(self.D_hat[c]), "held": held, "total": total}
        arrays |= {"D_seen": D.copy() if reads_commands else D}
        sees_X = loop.measurement.perfect and not self.refuses
        arrays |= {"X_hat": X, "Y": X} if sees_X else {"X_hat": X.copy()}
        sizes = assembly.sizes(loop, self.law) | {"past": round(loop.measurement.delay / loop.dt) + 1, "clock": 0}
        return State(**signals.memory(signals.STATE, sizes | {"outputs": 0}, D.shape[1], arrays))
