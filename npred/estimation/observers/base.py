"""An observer of the state: two kernels of one lane on a memory, and the sizes that a plant has by default."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError, unlisted
from npred.base.matrices import exponential
from npred.formulas import Value, programs, tape
from npred.formulas.trace import Trace, python
from npred.kernels.formula import Formulas, vector
from npred.kernels.kernel import Kernel, made, skeleton
from npred.plants.base import Plant, require
from npred.plants.speed import operating_point, rates
from npred.prediction.delays import problem

SIGMAS = 6.0  # standard deviations of an output, times `outlier_limit`: beyond them a sample is not believed
POINTS = 64  # places in the box, at which the sizes of f, kappa and the outputs are looked at
TINY = 1e-9  # relative: what is no more than a rounding error
FIRST = 0.01  # times the fastest time constant: the first time, after 0, at which outputs over time are looked at
GROWN = 1e6  # how far a deviation may grow meanwhile
WEAK = 1e-2  # of the largest: below it a singular value along a reference tells an estimate too little to converge


class Sizes(NamedTuple):
    """Usual sizes of a plant: states x and their half ranges dx (n,), sizes of f (n,), half ranges of the inputs du
    (m,) and of the outputs dy (l,), and the usual rate of the loop of kappa without delay (npred.plants.speed).
    """

    x: np.ndarray
    dx: np.ndarray
    f: np.ndarray
    du: np.ndarray
    dy: np.ndarray
    rate: float


class Observer(ABC):
    """An observer of the state X of a plant, from the commands and from samples Y of its outputs.

    The outputs are those that the plant declares by output(x, t, p, M), else all states; or those of its outputs and
    states that `outputs` names. With `offset` the observer also finds what is added to each input before the plant,
    X' = f(X, U + d). Its memory begins with X (n), then d (m), zeros without `offset`.

    X0 (n,) is the state to begin with. By default it is the middle of the plant's box, and for a state without a range
    there the rest, or the reference at t = 0, or the guess.
    Raises ConfigError for a plant that is not traced, for outputs that do not tell the state near rest, by
    all that they are over time, or, of a plant that does not rest, anywhere in the box, and for settings that do not
    fit.
    """

    settings: np.ndarray  # its kernels read this as `law`
    pulls = False  # whether it corrects the state between samples too

    def __init__(
        self, plant: Plant, *, offset: Any = False, X0: Any = None, outputs: Sequence[str] | None = None
    ) -> None:
        self.plant = plant
        require(plant)
        if not plant.traced:
            came = f"{plant.name}, which says traced = False"
            raise ConfigError(f"{self.label}: expected a plant that is traced, got {came}; write f with M's functions")
        if isinstance(outputs, str) or (outputs is not None and not len(outputs)):
            cure = f'write ("{outputs or plant.outputs[0]}",)'
            raise ConfigError(f"{self.label}: outputs expected a tuple of names, got {outputs!r}; {cure}")
        self.outputs = plant.outputs if outputs is None else tuple(outputs)
        names = dict.fromkeys((*plant.states, *plant.outputs))
        for name in self.outputs:
            if name not in names:
                kind = "states or outputs of the plant," if plant.declares_output else "states,"
                raise ConfigError(unlisted(f"{self.label}: outputs", name, names, kind))
        self.offset = offset is not False
        self.X0 = self.sizes.x if X0 is None else self.fitting("X0", X0, plant.n)
        rank = self._rank()
        if rank < self.size:
            where = "in the box" if not plant.rests else "over time" if self._timed else "at the rest"
            what = "states and offsets" if self.offset else "states"
            cure = "measure more, or leave the offset out" if self.offset else "measure more"
            what = f"expected {what} that {', '.join(self.outputs)} tell of {where} of plant {plant.name}"
            came = f"got an observability matrix of rank {rank} of {self.size}"
            raise ConfigError(f"{self.label}: {what}, {came}; {cure}")

    @property
    def label(self) -> str:
        """Its name in messages."""
        return type(self).__name__

    @property
    def size(self) -> int:
        """The number of states and offsets that are observed."""
        return self.plant.n + self.plant.m * self.offset

    def __getstate__(self) -> dict[str, Any]:
        """Its parts without those that were compiled, which are made again on use."""
        compiled = {name for name in dir(type(self)) if isinstance(getattr(type(self), name), cached_property)}
        return {name: value for name, value in vars(self).items() if name not in compiled}

    @abstractmethod
    def start(self) -> np.ndarray:
        """The memory to begin with, of one axis."""

    def anew(self) -> tuple[np.ndarray, np.ndarray]:
        """The memory for a restart, and 1 for each variance of the first state in it."""
        return self.start(), np.zeros(len(self.start()))

    def numbers(self, plant: Plant, dt: float, input_bounds: np.ndarray) -> dict[str, Any]:
        """The settings of a loop with it."""
        memory, widens = self.anew()
        return {
            "sensing": self.settings, "pulls": self.pulls, "offsets": self.offset,
            "filter_count": len(memory), "anew": memory, "widens": widens,
        }  # fmt: skip

    def kernels(self, plant: Plant) -> dict[str, Kernel]:
        """The kernels of a loop with it."""
        return {"follow": self.follow, "correct": self.correct}

    def axes(self, plant: Plant) -> dict[str, int]:
        """The axes of its signals."""
        return {"filter": len(self.start())}

    @property
    @abstractmethod
    def filter(self) -> Any:
        """The extended Kalman filter of the same outputs and offsets: an observer of the delay takes its gains."""

    @property
    @abstractmethod
    def follow(self) -> Kernel:
        """npred.prediction.delays.problem.FOLLOW: the memory a step on, by the inputs that act meanwhile."""

    @property
    @abstractmethod
    def correct(self) -> Kernel:
        """problem.CORRECT_BY of npred.prediction.delays: the memory corrected by a sample, and the difference."""

    def fitting(self, name: str, value: Any, size: int) -> np.ndarray:
        """Finite numbers (size,), or one for all. Raises ConfigError for others."""
        array = array_checks.floats(f"{self.label}: {name}", value)
        if array.shape not in ((), (size,)):
            came = array.shape
            raise ConfigError(f"{self.label}: {name} expected one number or shape ({size},), got {came}; give {size}")
        array_checks.finite(f"{self.label}: {name}", array)
        return np.broadcast_to(array, size).astype(float)

    @cached_property
    def sizes(self) -> Sizes:
        """The usual sizes of the plant, by points of its box: all at the input that kappa gives at t = 0."""
        plant, (X, ends) = self.plant, self._box
        with np.errstate(all="ignore"):
            U = plant.kappa(X)
            f, Y = plant.f(X, U), self.measured(X)
        half = [0.5 * np.ptp(a, axis=0) for a in (_finite(U), _finite(Y))]
        parts = [(ends[1] - ends[0]) / 2, np.sqrt((_finite(f) ** 2).mean(axis=0)), *half]
        dx, rms, du, dy = (np.where(a > 0, a, 1.0) for a in parts)
        return Sizes(ends.mean(axis=0), dx, rms, du, dy, rates(plant).usual)

    def linearised(self, x: np.ndarray, u: np.ndarray, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """A and C of z' = A z, y = C z near a point x (n,), u (m,), z the state and the offsets, where observed."""
        n, size, count = self.plant.n, self.size, len(self.outputs)
        A, C = np.zeros((size, size)), np.zeros((count, size))
        A[:n, :n], f_U = self.plant.jacobians(x, u, t)
        A[:n, n:] = f_U[:, : size - n]
        C[:, :n] = np.reshape(self._output_program(*x, t, *self.plant.p)[count:], (count, n))
        return A, C

    def _rank(self) -> int:
        """How many states and offsets the outputs tell of: over time, where the plant is to be; of a plant that does
        not rest at the best of some points of the box, too.
        """
        plant = self.plant
        if plant.rests:
            return self._rank_over_time() if self._timed else self.rank(*self.operating_point)
        moments = np.linspace(0.0, plant.period or POINTS / self.sizes.rate, POINTS, endpoint=False).tolist()
        points = [(x, plant.kappa(x, t), t) for x, t in zip(self._box[0], moments, strict=True)]
        rank = max(self.rank(*point) for point in [(*self.operating_point, 0.0), *points])
        return max(rank, self._rank_over_time()) if plant.tracks and rank < self.size else rank

    def rank(self, x: np.ndarray, u: np.ndarray, t: float = 0.0) -> int:
        """The rank of the observability matrix near a point, in units of the sizes and of the rate."""
        A, C = self._scaled(x, u, t)
        A, rows = A / self.sizes.rate, [C]
        for _ in range(1, self.size):
            rows.append(rows[-1] @ A)
            rows[-1] /= max(1.0, float(np.abs(rows[-1]).max()))
        return int(np.linalg.matrix_rank(np.concatenate(rows), tol=TINY))

    def _rank_over_time(self) -> int:
        """The rank of C(t) Φ(t), Φ' = A(t) Φ, along the equilibrium or the reference.

        At times of growing distance: an output with a period would look the same at even ones.
        """
        plant, flow, now = self.plant, np.eye(self.size), 0.0
        A, C = self._scaled(*self.operating_point)
        fastest, rows = max(self.sizes.rate, float(np.abs(np.linalg.eigvals(A)).max())), [C]
        for t in np.geomspace(FIRST / fastest, plant.period or POINTS / self.sizes.rate, POINTS).tolist():
            middle = (now + t) / 2
            A, _ = self._scaled(plant.target(middle), plant.u_target(middle), middle)
            if not np.isfinite(A).all() or not np.abs(flow := exponential(A * (t - now)) @ flow).max() < GROWN:
                break
            rows.append(self._scaled(plant.target(t), plant.u_target(t), t)[1] @ flow)
            rows[-1] /= max(1.0, float(np.abs(rows[-1]).max()))
            now = t
        return int(np.linalg.matrix_rank(np.concatenate(rows), rtol=TINY if plant.rests else WEAK))

    def _scaled(self, x: np.ndarray, u: np.ndarray, t: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """A and C of `linearised` in units of the sizes."""
        (A, C), sizes = self.linearised(x, u, t), self.sizes
        units = np.concatenate([sizes.dx, sizes.du])[: self.size]
        return A * units / units[:, None], C * units / sizes.dy[:, None]

    def measured(self, X: np.ndarray, t: float = 0.0) -> np.ndarray:
        """The outputs (..., l) of states (..., n)."""
        every = X if self._selects else np.concatenate([X, self.plant.output(X, t)], axis=-1)
        return every[..., self._places]

    def traced_outputs(self, trace: Trace, x: np.ndarray, t: Value) -> list[Value]:
        """The outputs (l,) on a trace."""
        every = [*x] if self._selects else [*x, *trace.output(x, t)]
        return [every[place] for place in self._places]

    def measure(self) -> Kernel:
        """npred.prediction.delays.problem.OUTPUT: the outputs of a state, without errors."""
        of = Formulas(self.plant, ())
        y = self.traced_outputs(of.trace, of.trace.vector("x", self.plant.n), of.trace.input("t"))
        shown = of.function(y, [vector("x", self.plant.n, "1"), "t"], {"y": len(y)}, "1")
        return made("measure", problem.OUTPUT, skeleton("measure.h"), {"SHOWN": shown}, {"N": self.plant.n})

    def output_function(self, of: Formulas) -> str:
        """The C function of the outputs (l,) and of their derivatives by the state (l, n)."""
        outputs, by_x = self._by_state(of.trace)
        results = {"y": len(outputs), "by_x": len(by_x)}
        return of.function([*outputs, *by_x], [vector("x", self.plant.n, "1"), "t"], results, "1")

    @property
    def _timed(self) -> bool:
        """True if time changes how the outputs depend on the state."""
        trace = Trace(self.plant)
        return programs.depends(self._by_state(trace)[1], [trace.input("t")])

    @property
    def _places(self) -> list[int]:
        """Their places among states, then outputs; a name of both is the state, unless all are the plant's outputs."""
        states, outputs = self.plant.states, self.plant.outputs
        all_own = self.plant.declares_output and self.outputs == outputs
        return [
            states.index(name) if name in states and not all_own else len(states) + outputs.index(name)
            for name in self.outputs
        ]

    @property
    def _selects(self) -> bool:
        """True if the outputs are states, and none of the plant's own."""
        return max(self._places) < self.plant.n

    def _by_state(self, trace: Trace) -> tuple[list[Value], list[Value]]:
        """The outputs (l,) at x and t, and their derivatives by the state (l n,), output by output."""
        x = trace.vector("x", self.plant.n)
        y = self.traced_outputs(trace, x, trace.input("t"))
        columns = [programs.derivative(y, [*x], [*unit]) for unit in np.eye(len(x))]
        return y, [column[i] for i in range(len(y)) for column in columns]

    @cached_property
    def _output_program(self) -> Any:
        trace = Trace(self.plant)
        outputs, by_x = self._by_state(trace)
        names = [*tape.names("x", self.plant.n), "t", *tape.names("p", len(self.plant.p))]
        return python([*outputs, *by_x], names)

    @cached_property
    def operating_point(self) -> tuple[np.ndarray, np.ndarray]:
        """X and U of npred.plants.speed.operating_point."""
        return operating_point(self.plant)

    @cached_property
    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        """Points of the box (POINTS, n), and its ends (2, n)."""
        X = self.operating_point[0]
        low, high = ends = self.plant.ranges(X, np.maximum(1.0, np.abs(X))).T
        return np.random.default_rng(0).uniform(low, high, (POINTS, self.plant.n)), ends


def _finite(rows: np.ndarray) -> np.ndarray:
    """The rows without NaN and infinity; zeros where there are none."""
    kept = rows[np.isfinite(rows).all(axis=-1)]
    return kept if len(kept) else np.zeros((1, rows.shape[-1]))
