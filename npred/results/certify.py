"""The result of the stage certify."""

from typing import Annotated

from npred.results.base import Number, Result
from npred.results.contender import RANKED, Name


class Certificate(Result):
    """One network: what is bounded with a confidence, what was searched, and what its loops do."""

    #: the largest |κ(P̂(1)) − κ(P(1))| of the rollouts, at `samples` random times of each; with `confidence`, at most a
    #: share `probability` of fresh rollouts of the same distribution, sampled likewise, has a larger one. As all errors
    #: of U here it is that of the largest component, which the guard's tolerance is for; evaluate's takes the norm,
    #: which is up to √m as large for m inputs
    eps_kappa: Number
    probability: float  #: as the pipeline has it
    confidence: float  #: as the pipeline has it
    rollouts: int  #: how many
    samples: int | None = None  #: of each rollout, at random times; none in a result of an older npred
    median: Number  #: the median over the rollouts
    adversarial: Number  #: the largest error of U that the search came to: a lower bound of the uniform one
    adversarial_median: Number  #: the median over its calls
    calls: int  #: calls of the search
    above: int  #: those whose error is above the tolerance
    unnoticed: int  #: of these, those that the guard lets pass
    blind_calls: int  #: calls of the search for inputs that the guard lets pass, with as large an error as there is
    blind: int  #: of these, those that it lets pass with an error above the tolerance
    blind_error: Number  #: the largest error that it let pass there
    tolerance: float  #: of the guard, in units of U
    by: str  #: how the guard estimates, `shadow`
    fallback_rollouts: float  #: share of the rollouts' samples that the guard answers numerically
    #: the estimate over the true error where that is within 0.3 to 3 tolerances, at 1 %, 50 % and 99 %; empty where
    #: there is no such call
    ratio: list[float]
    #: `guarded.bound` over the true error at the worst samples of 1000 rollouts, at 1 %, 50 % and 99 %; empty where the
    #: plant has none
    bound: list[float]
    bounded: float | None  #: share of these samples that have a bound; none where the plant has none
    lost: int  #: loops that are lost with the network and kept by the numerical predictor
    lost_guarded: int  #: the same with the guarded network
    peak: Number  #: the largest distance from rest of its loops over that of the numerical predictor's
    peak_guarded: Number  #: the same with the guarded network
    fallback: float  #: share of the guarded loops' steps in which the numerical predictor answered


class Certified(Result):
    """Certificates of the networks. They hold for the distribution that rollouts are drawn from; none is a proof."""

    plant: str  #: its name
    loops: int  #: fresh starts whose loops were run
    lost_numerical: int  #: of these, those that the numerical predictor loses
    models: Annotated[dict[Name, Certificate], RANKED]  #: by network
