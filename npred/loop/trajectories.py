"""The record of closed loops: their series, chosen single steps, and their ends."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from npred.loop import trajectory_views
from npred.loop.signals import Record
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4, Predictor

# a record's arrays, led by the batch's axes
SERIES = tuple(name for name in Record._fields if not name.startswith("sample") and name != "breach")
LOOPS = (*SERIES, "margin", "breach")


@dataclass(frozen=True)
class Samples:
    """(X, u, D_hat) of each loop at chosen steps: X (..., S, n), u (..., S, nx, m), D_hat (..., S)."""

    X: np.ndarray
    u: np.ndarray
    D_hat: np.ndarray


@dataclass(frozen=True)
class OnAClock:
    """The record that loops on a real clock add to the series of all loops; rows are those times.

    `X_hat` (..., nt, n) is the state that the controller predicted from, `age` (..., nt) how old its last used sample
    is, in seconds, `handed_over` (..., nt) whether the watchdog has U. Of each loop (...): the calls that were
    `skipped`, the commands `lost`, the calls that gave no U (`refusals`), the samples that came too `late` and those
    that were `refused`, and `offset` (..., m), the last estimate of a constant that is added to U.
    """

    X_hat: np.ndarray
    age: np.ndarray
    handed_over: np.ndarray
    skipped: np.ndarray
    lost: np.ndarray
    refusals: np.ndarray
    late: np.ndarray
    refused: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True, repr=False)
class Trajectories:
    """Closed loops: t (nt,) in seconds, X and P (..., nt, n), U (..., nt, m), D_hat, N and energy (..., nt).

    P is the prediction at x = 1, P(1, t), for X(t + D_hat); NaN in the open loop.
    N = 1 + V + b ∫₀¹ (1+x) w² dx of the u that the controller reads, NaN without adaptation; energy = ∫_{t-D}^t
    |U - U*|² ds with the true D; see npred.loop.lyapunov.
    `escaped` (...) is the first step whose state is not finite, or -1; `infeasible` (...) the first step at which
    commands would overtake each other, 1 - D_X f - D_t <= 0, or -1, `margin` (...) that value and `breach` (..., n) the
    state there, in the plant or at a node of a prediction, which crosses 0 early: where the exact loop has up to .2.
    `D_hat_spread` (...) is half the range of the delays that the last D_hat may be taken for (npred.loop.status), NaN
    where it does not come from an observer.
    With a guarded predictor `fallback` (..., nt) says where the numerical predictor answered, since the time before,
    and `fallbacks` (...) in how many of the `steps` control steps. With a safety filter `filtered` (..., nt) says where
    U was changed, likewise, `changes` (...) in how many steps, `promised` (..., nt) where a plan was promised to keep
    all limits, and `unkept` (...) in how many steps no U kept all; `safety` (..., nt, limits) is safe(x, t, p, M) of
    the plant's states. `states`, `inputs`, `time_unit`, `labels` and `units` are the plant's. At or beyond `ends` D_hat
    is at a bound of its law; None if frozen. `clock` is what loops on a real clock add, else None. `target` (nt, n) and
    `u_target` (nt, m) are X* and U* of the set-points of the time, None without `setpoints`.

    print(loop) gives the ranges and ends of all series.
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
    infeasible: np.ndarray
    D_hat_spread: np.ndarray
    margin: np.ndarray
    breach: np.ndarray
    fallback: np.ndarray
    fallbacks: np.ndarray
    filtered: np.ndarray
    changes: np.ndarray
    promised: np.ndarray
    unkept: np.ndarray
    steps: int
    states: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    time_unit: str = "s"
    labels: Mapping[str, str] | None = None
    units: Mapping[str, str] | None = None
    ends: tuple[float, float] | None = None
    clock: OnAClock | None = None
    limits: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    target: np.ndarray | None = None
    u_target: np.ndarray | None = None

    @cached_property
    def safety(self) -> np.ndarray | None:
        """safe(x, t, p, M) of the simulated plant's states, (..., nt, limits); None where it declares none."""
        return None if self.limits is None else self.limits(self.X, self.t)

    @property
    def fallback_share(self) -> float:
        """The share of the control steps of all loops in which a guarded predictor's numerical one answered."""
        return float(self.fallbacks.mean() / self.steps)

    @property
    def filtered_share(self) -> float:
        """The share of the control steps of all loops in which a safety filter changed U."""
        return float(self.changes.mean() / self.steps)

    def __repr__(self) -> str:
        return trajectory_views.summary(self)

    def _repr_html_(self) -> str:
        return trajectory_views.html(self)

    def plot(
        self, D: Any = None, ax: Any = None, label: str | None = None, *,
        signals: Sequence[str] = trajectory_views.SIGNALS, size: str | tuple[float, float] | None = None,
    ) -> Any:  # fmt: skip
        """States, inputs and D_hat over time, a panel each, all loops in each; `D` (...) adds the true delay, dashed.

        `signals` chooses panels: "X", "U", "D_hat", or single states and inputs by name; by default all, or those of
        `ax`. `size` is that of the figure:
        width and height in inches, or "article", a column of 3.5 inches in letters of 7 points.
        Gives matplotlib's axes, one a panel; their figure is `axes[0].figure`, shown by matplotlib.pyplot.show().
        Loops are compared in one figure with a label each, which has one colour in all panels:

            axes = first.plot(label="first")
            second.plot(ax=axes, label="second")

        A loop that runs away (it leaves the finite numbers, or grows by half again in the last tenth of the time) may
        leave the picture, so that the others can be seen.
        Raises ConfigError where `ax` is not as many axes as there are series, for an unknown signal and another size.
        """
        return trajectory_views.plot(self, D, ax, label, signals, size)

    def to_dataframe(self) -> Any:
        """A pandas DataFrame: a row per kept time, a column per state and input, and D_hat; the index is t.

        A batch's index has the loop's number along each axis before t. A name that stands twice gets its letter in
        front, as `X.h` and `U.h`. Raises MissingError where pandas is not installed.
        """
        return trajectory_views.dataframe(self)

    def part(self, rows: slice) -> "Trajectories":
        """The loops `rows` of a batch with one axis."""
        cut = {name: getattr(self, name)[rows] for name in LOOPS}
        clock = self.clock and each(lambda a: a[rows], self.clock)
        return replace(self, samples=each(lambda a: a[rows], self.samples), clock=clock, **cut)

    @classmethod
    def joined(cls, parts: Sequence["Trajectories"]) -> "Trajectories":
        """The loops of several batches of one axis and the same times, one batch after the other."""

        first, clocks = parts[0], [part.clock for part in parts if part.clock]
        clock = each(lambda *arrays: np.concatenate(arrays), *clocks) if clocks else None
        samples = each(lambda *arrays: np.concatenate(arrays), *(part.samples for part in parts))
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in LOOPS}
        return replace(first, samples=samples, clock=clock, **arrays)


def each(change: Callable[..., np.ndarray], *of: Any) -> Any:
    """Samples or OnAClock of the arrays of one or several that `change` makes one of."""
    return type(of[0])(**{f.name: change(*(getattr(part, f.name) for part in of)) for f in fields(of[0])})


def of_record(
    r: Record, shape: tuple[int, ...], step: float, steps: int, plant: Plant, truth: Plant,
    predictor: Predictor | None, ends: tuple[float, float] | None, clock: OnAClock | None = None,
) -> Trajectories:  # fmt: skip
    """The loops of a batch of so many control steps, kept each `step`; `clock` has the loops first."""

    def lead(a: np.ndarray) -> np.ndarray:
        """Lanes last to the batch's shape first."""
        return np.moveaxis(a, -1, 0).reshape((*shape, *a.shape[:-1]))

    samples = Samples(lead(r.sample_X[:-1]), lead(r.sample_u[:-1]), lead(r.sample_D_hat[:-1]))
    series = {name: lead(getattr(r, name)) for name in SERIES}
    times = np.arange(len(r.X)) * step
    clock = clock and each(lambda a: a.reshape((*shape, *a.shape[1:])), clock)
    return Trajectories(
        t=times, samples=samples, states=plant.states, inputs=plant.inputs, time_unit=plant.time_unit,
        labels=plant.labels, units=plant.units, margin=lead(margins(r, plant, truth, predictor)),
        breach=lead(r.breach[: plant.n]), steps=steps, ends=ends, clock=clock,
        limits=truth.safe if truth.declares_safe else None, **series,
    )  # fmt: skip


def margins(r: Record, plant: Plant, truth: Plant, predictor: Predictor | None) -> np.ndarray:
    """1 - D_X f - D_t where and when a loop was marked as infeasible, (B,); NaN in the others.

    A loop is marked by the prediction of its model, at the time when the node comes, or by the simulated plant.
    """
    margin = np.full((1, len(r.infeasible)), np.nan)
    for l in np.flatnonzero(r.infeasible >= 0).tolist():
        X, U, t = r.breach[: plant.n, [l]].copy(), r.breach[plant.n : -1, [l]].copy(), float(r.breach[-1, l])
        of = truth
        if np.isfinite(r.sample_D_hat[-1, l]):
            of, t = plant, _arrival(r, l, t, plant, predictor)
        speed, value = problem_of(of).speed(), np.empty((plant.m, 1))
        assert speed is not None  # no other loop is marked
        speed(X, U, t, of.p, value)
        margin[0, l] = value[0, 0]
    return margin[0]


def _arrival(r: Record, l: int, t: float, plant: Plant, predictor: Predictor | None) -> float:
    """The time of the last finite node of the prediction that ended in loop l at time t, by the predictor's method."""
    step = getattr(getattr(predictor, "exact", predictor), "step", RK4.step)
    X = np.append(r.sample_X[-1, :, l], t)[:, None]
    u, D_hat = np.array(r.sample_u[-1][..., [l]], order="C"), r.sample_D_hat[-1, [l]]
    P = np.empty((len(u), plant.n + 1, 1))
    problem_of(plant).sweep(step, timed=True)(X, u, D_hat, t, plant.p, P)  # type: ignore[call-arg]
    return float(P[np.isfinite(P[:, -1, 0]), -1, 0][-1])
