"""The result of the stage evaluate."""

from typing import Annotated

from pydantic import AliasChoices, Field

from npred.results.base import Number, Result
from npred.results.contender import RANKED, Name


class Relative(Result):
    """The largest error over x divided by the distance from rest, over the samples."""

    sup: Number  #: the largest
    median: Number  #: the median


class Errors(Result):
    """Errors against the numerical predictor; all are 0 for `numerical` and `no_adaptation`."""

    mse: Number  #: mean square of P̂ − P
    eps_sup: Number  #: largest |P̂ − P|
    eps_kappa: Number  #: largest |κ(P̂(1)) − κ(P(1))|, what the control sees
    rel_l2: Number  #: mean of ‖P̂ − P‖ / ‖P‖
    mse_by_state: dict[str, Number] = {}  #: `mse` by the states' names; networks only
    sup_by_state: dict[str, Number] = {}  #: the largest error by the states' names; networks only
    #: `sup` and `median` of the error over the distance from rest; networks only, and of a plant that rests
    eps_relative: Relative | None = None


class KindErrors(Errors):
    """Errors on the held-out rows of one kind."""

    above: Number  #: share of the rows with an error above the `eps_sup` of the kind `held_out_kind`


class Radii(Result):
    """How far from rest, or from the reference, loops end: the largest distance over the last tenth."""

    median: Number  #: over the cases
    worst: Number  #: over the cases
    converged: float  #: share of the cases
    cases: int  #: how many

    @property
    def count(self) -> int:
        """The number of cases that converge."""
        return round(self.converged * self.cases)


class Radius(Radii):
    """The same beside what the error of the prediction explains."""

    predicted: Number  #: `gain` times `eps_kappa`


class Limits(Result):
    """How loops keep what the plant declares by `safe`, over the cases."""

    least: float | None  #: the smallest h at the kept times; `null` where a loop leaves the finite numbers
    filtered: float | None  #: share of the control steps in which the safety filter changed U; `null` without one
    unkept: int | None  #: number of steps in which the bounds of U left no way to keep the limits, likewise


class DelayMap(Result):
    """The loops that converge, by true delay and first estimate."""

    D: list[float]  #: true delays, in seconds
    D_hat0: list[float]  #: first estimates, in seconds
    converged: list[list[bool]]  #: one row per D
    share: float  #: of the loops that converge with the numerical predictor
    band: tuple[float, float] | None  #: of D, within which none of those is lost; `null` where there is none


class LoopEnd(Result):
    """The end of the loop of Fig. 1."""

    X_end: list[Number]  #: the state
    D_hat_end: Number  #: the delay estimate
    radius: Number  #: the largest distance over the last tenth
    settle_time: Number  #: in seconds


class Scores(Errors):
    """One contender. Its errors are on the held-out rows of the kind `held_out_kind`."""

    kinds: dict[str, KindErrors]  #: by kind all these on its held-out rows, and `above`
    fresh: Errors  #: all these on the fresh samples
    #: the largest |P(1, t) − X(t + D)| where D̂ = D, see [accuracy](../accuracy.md#the-error-in-the-loop); `null`
    #: where a loop is lost
    in_loop: Number
    radius: Radius  #: over the cases
    settle_time: Number  #: the median over the cases, in seconds
    settle_ratio: float | None  #: the median of it over the numerical predictor's
    decay_rate: float | None  #: the median rate at which loops decay near rest, in 1/s; `null` where none does
    map: DelayMap | None  #: over true delays and first estimates; `null` without a map
    figure1: LoopEnd  #: the loop of Fig. 1
    #: share of its loops' steps in which the numerical predictor answered; `null` without a guard
    fallback: float | None = None
    limits: Limits | None = None  #: of a plant that declares `safe`


class KindSize(Result):
    """Held-out rows of one kind."""

    rows: int  #: how many


class InLoop(Result):
    """The loops that the errors in the loop are of."""

    #: the delay, which the estimate equals, in seconds; `null` where the plant declares its delay
    D: float | None
    #: errors are taken from this time on, in seconds; `null` where it differs by loop
    start: float | None = Field(validation_alias=AliasChoices("from", "start"), serialization_alias="from")
    to: float  #: and up to this time
    loops: int  #: how many


class Coverage(Result):
    """One state, input, or `D_hat`."""

    data: tuple[float, float]  #: its range in the data
    outside: dict[Name, Number]  #: by network, the share of its loop steps beyond that range


class Behaviour(Result):
    """What one contender's loops do in a scenario."""

    radius: Radii  #: over the cases
    settle_time: Number  #: the median over the cases, in seconds
    #: loops that leave the finite numbers, whose commands would overtake each other, or that end further away than a
    #: fifth of the distance that radii are measured against
    lost: int
    overtaking: int = 0  #: those of them whose commands would overtake each other
    #: the largest |D̂ − D| over the last tenth and the cases, in seconds; `null` where there is no estimate
    D_error: float | None
    #: share of the steps in which the numerical predictor answered; `null` without a guard
    fallback: float | None = None
    limits: Limits | None = None  #: of a plant that declares `safe`


class Conditions(Result):
    """One scenario of the pipeline."""

    name: str  #: as the pipeline calls it
    models: Annotated[dict[Name, Behaviour], RANKED]  #: the numerical predictor and each network


class Evaluated(Result):
    """Errors on held-out samples, and what closed loops make of them.

    NAME is `numerical`, `no_adaptation` (where the estimate adapts), a network as `deeponet`, or a snapshot as
    `deeponet@20`.
    """

    plant: str  #: its name
    equilibrium: list[float] | None  #: where it rests, one number per state; `null` for one that follows a trajectory
    gain: Number  #: how far a constant error of 1 in the control law moves the loop
    held_out: int  #: how many samples of held-out rollouts the errors are taken on
    held_out_kind: str  #: which kind of row the errors of `models` are of: `nominal`, or `imported`
    #: by kind of held-out row: `nominal`, `exploring` and `redrawn` where the data have them, or `imported`
    kinds: dict[str, KindSize]
    fresh: int  #: how many samples of rollouts made for this evaluation
    in_loop: InLoop  #: what the errors in the loop are of
    models: Annotated[dict[Name, Scores], RANKED]  #: by NAME what was measured
    coverage: dict[str, Coverage]  #: by state, input and `D_hat`
    scenarios: list[Conditions] = []  #: of a pipeline that has any, the same loops under other conditions
