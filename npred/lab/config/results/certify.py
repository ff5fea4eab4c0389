"""The result of the stage certify."""

from typing import Annotated

from pydantic import AliasChoices, Field

from npred.lab.config.results.base import RANKED, Name, Number, Result


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
