"""The results of the stages evaluate and certify."""

from typing import Annotated

from pydantic import AliasChoices, Field

from npred.lab.config.results.base import RANKED, Name, Number, Result

POOR = 0.02  # relative L² error of a network: in pipelines that are meant to be used, less than a tenth of it


class Relative(Result):
    """The largest error over x, divided by the distance from rest."""

    sup: Number  #: the largest over the samples
    median: Number  #: the median over the samples


class Errors(Result):
    """Errors against the numerical predictor; all are 0 for `numerical` and `no_adaptation`."""

    mse: Number  #: mean square of P̂ − P
    eps_sup: Number  #: largest |P̂ − P|
    eps_kappa: Number  #: largest |κ(P̂(1)) − κ(P(1))|
    rel_l2: Number  #: mean of ‖P̂ − P‖ / ‖P‖
    mse_by_state: dict[str, Number] = {}  #: `mse` of each state; networks only
    sup_by_state: dict[str, Number] = {}  #: `eps_sup` of each state; networks only
    #: relative errors; only networks, and plants with an equilibrium
    eps_relative: Relative | None = None


class KindErrors(Errors):
    """Errors on the held-out rows of one kind."""

    above: Number  #: share of the rows with an error above `eps_sup` of the kind `held_out_kind`


class Radii(Result):
    """The largest distance from rest, or from the reference, over the last tenth of the loops."""

    median: Number  #: over the cases
    worst: Number  #: over the cases
    converged: float  #: share of the cases
    cases: int  #: how many

    @property
    def count(self) -> int:
        """The number of cases that converge."""
        return round(self.converged * self.cases)


class Radius(Radii):
    """The largest distance from rest, or from the reference, over the last tenth of the loops."""

    predicted: Number  #: `gain` times `eps_kappa`


class Limits(Result):
    """How loops keep the limits that the plant declares by `safe`, over the cases."""

    least: float | None  #: the smallest h at the kept times; `null` if a loop overflows
    filtered: float | None  #: share of the control steps in which the safety filter changed U; `null` without one
    unkept: int | None  #: number of steps in which no U within the bounds was found that keeps all limits, likewise


class DelayMap(Result):
    """The loops that converge, by true delay and first estimate."""

    D: list[float]  #: true delays, in the plant's unit of time
    D_hat: list[float]  #: first estimates
    converged: list[list[bool]]  #: one row per D
    share: float  #: share of the numerical predictor's converging loops
    band: tuple[float, float] | None  #: range of D in which all of them converge; `null` for none


class LoopEnd(Result):
    """The end of the loop of Fig. 1."""

    X_end: list[Number]  #: the state
    D_hat_end: Number  #: the delay estimate
    radius: Number  #: the largest distance over the last tenth
    settle_time: Number  #: in the plant's unit of time


class Scores(Errors):
    """One predictor. Its errors are on held-out rows of the kind `held_out_kind`."""

    kinds: dict[str, KindErrors]  #: errors by kind of held-out row
    fresh: Errors  #: the same errors on the fresh samples
    #: the largest |P(1, t) − X(t + D)| with D̂ = D ([accuracy](../accuracy.md#the-error-in-the-loop)); `null` if a
    #: loop overflows
    in_loop: Number
    radius: Radius  #: over the cases
    settle_time: Number  #: the median over the cases, in the plant's unit of time
    settle_ratio: float | None  #: `settle_time` over the numerical predictor's, median
    decay_rate: float | None  #: the median decay rate near rest, in 1 / time; `null` without decay
    map: DelayMap | None  #: convergence by D and D̂(0); `null` without a map
    figure1: LoopEnd  #: the loop of Fig. 1
    figure1_bounded: LoopEnd | None = None  #: the same with U within `figure_bounds`; `null` without them
    #: share of its loops' steps with a numerical answer; `null` without a guard
    fallback: float | None = None
    limits: Limits | None = None  #: for a plant that declares `safe`


class KindSize(Result):
    """Held-out rows of one kind."""

    rows: int  #: how many


class InLoop(Result):
    """The loops of the errors in the loop."""

    #: the delay; `null` if the plant declares its delay
    D: float | None
    #: first time; `null` if it differs by loop
    start: float | None = Field(validation_alias=AliasChoices("from", "start"), serialization_alias="from")
    to: float  #: last time
    loops: int  #: how many


class Coverage(Result):
    """One state, input, or `D_hat`."""

    data: tuple[float, float]  #: range in the data
    outside: dict[Name, Number]  #: by network, share of loop steps outside this range


class Behaviour(Result):
    """The loops of one predictor in a scenario."""

    radius: Radii  #: over the cases
    settle_time: Number  #: the median over the cases, in the plant's unit of time
    #: loops that overflow, whose commands overtake each other, or that end farther away than a fifth of the size that
    #: radii are relative to
    far: int = Field(validation_alias=AliasChoices("far", "diverged"))
    overtaking: int = 0  #: those of them whose commands overtake each other
    #: the largest |D̂ − D| over the last tenth and the cases; `null` without an estimate
    D_error: float | None
    #: share of the steps with a numerical answer; `null` without a guard
    fallback: float | None = None
    limits: Limits | None = None  #: for a plant that declares `safe`


class Conditions(Result):
    """One scenario of the pipeline."""

    name: str  #: as the pipeline calls it
    models: Annotated[dict[Name, Behaviour], RANKED]  #: the numerical predictor and each network


class Evaluated(Result):
    """Errors on held-out samples, and closed loops.

    NAME is `numerical`, `no_adaptation`, a network such as `deeponet`, or a snapshot such as `deeponet@20`.
    """

    plant: str  #: its name
    equilibrium: list[float] | None  #: one number per state; `null` if the plant tracks
    gain: Number  #: distance that a small constant error of U moves the rest, over the error, if the loop settles
    held_out: int  #: number of held-out samples
    held_out_kind: str  #: kind of row of the errors of `models`: `nominal`, or `imported`
    #: by kind of held-out row: `nominal`, `exploring`, `redrawn`, or `imported`
    kinds: dict[str, KindSize]
    fresh: int  #: number of samples of new rollouts
    in_loop: InLoop  #: the loops of the errors in the loop
    models: Annotated[dict[Name, Scores], RANKED]  #: by NAME
    coverage: dict[str, Coverage]  #: by state, input and `D_hat`
    scenarios: list[Conditions] = []  #: the loops under other conditions

    @property
    def caution(self) -> str:
        """A sentence where no network is good, as in a pipeline that only tests the chain; empty where one is."""
        errors = [row.rel_l2 for each, row in self.models.items() if each.is_network and each.epoch is None]
        if not errors or min(errors) < POOR:
            return ""
        return (
            f"No network here predicts well: the mean error is {min(errors):.0%} of the state or more. Train longer "
            "(epochs), then on more samples; until then take its numbers for a test of the program, not of networks."
        )


class Certificate(Result):
    """One network. Errors of U are of the largest component."""

    #: the largest |κ(P̂(1)) − κ(P(1))| of the rollouts; with `confidence`, at most a share `probability` of such
    #: rollouts has a larger one
    eps_kappa: Number
    probability: float  #: as the pipeline has it
    confidence: float  #: as the pipeline has it
    rollouts: int  #: how many
    samples: int | None = None  #: random times of each rollout
    median: Number  #: the median over the rollouts
    tolerance: float  #: the guard's, in units of U
    fallback_rollouts: float  #: share of the rollouts' samples with a numerical answer
    #: loops that overflow or end far from rest with the network, and do not with the numerical predictor
    far: int = Field(validation_alias=AliasChoices("far", "diverged"))
    #: the same for the guarded network
    far_guarded: int = Field(validation_alias=AliasChoices("far_guarded", "diverged_guarded"))
    peak: Number  #: largest distance from rest, over the numerical predictor's
    peak_guarded: Number  #: the same for the guarded network
    fallback: float  #: share of the guarded loops' steps with a numerical answer
    adversarial: Number | None = None  #: the largest error of U that the search found; `null` without a search
    adversarial_median: Number | None = None  #: the median over the calls of the search
    calls: int | None = None  #: calls that the search made
    above: int | None = None  #: calls with an error above the tolerance
    unnoticed: int | None = None  #: those of them that the guard passed
    blind_calls: int | None = None  #: calls of the search for errors that the guard lets pass
    blind: int | None = None  #: those of them that passed with an error above the tolerance
    blind_error: Number | None = None  #: the largest error that passed
    #: estimate over true error, for errors of 0.3 to 3 tolerances, at 1 %, 50 % and 99 %
    ratio: list[float] = []
    #: the bound over the true error at the worst samples of 1000 rollouts, at 1 %, 50 % and 99 %; else empty
    bound: list[float] = []
    bounded: float | None = None  #: share of these samples with a bound


class Certified(Result):
    """Certificates of the networks, for the distribution of the rollouts. They are no proofs."""

    plant: str  #: its name
    loops: int  #: loops from fresh starts
    #: those of them that overflow or end far from rest with the numerical predictor
    far_numerical: int = Field(validation_alias=AliasChoices("far_numerical", "diverged_numerical"))
    models: Annotated[dict[Name, Certificate], RANKED]  #: by network
