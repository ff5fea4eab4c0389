"""The result of the stage refine, of one network."""

from pydantic import field_validator

from npred.results.base import Number, Result
from npred.results.certify import Certificate
from npred.results.contender import Contender, Name, ranked


class HostileLoops(Result):
    """What loops of one kind do."""

    lost: int  #: with the bare network, of those that the numerical predictor keeps
    lost_guarded: int  #: the same with the guarded network
    fallback: float  #: share of the guarded loops' steps in which the numerical predictor answered


class Refinement(Result):
    """A network before the further training or after it; every number is of inputs that it was not trained on."""

    mse: Number  #: mean square error on the held-out rows of the data
    eps_sup: Number  #: largest |P̂ − P| on them
    limit: Number  #: of its domain: how far from the data's mean an input may be, in standard deviations
    certificate: Certificate  #: fresh rollouts, an adversary's search against these weights, nominal loops
    hostile: dict[str, HostileLoops]  #: by kind of loop
    fallback: float  #: share of the steps of all hostile loops in which the numerical predictor answered
    lost: int  #: of all hostile loops
    lost_guarded: int  #: of all hostile loops


class Refined(Result):
    """What further training on failures buys, and what it costs."""

    model: str  #: the network's name
    adversary: int  #: rows of an adversary's search that were trained on
    fallbacks: int  #: rows of guarded loops that the guard had refused
    data: int  #: rows of the data that were trained on again
    epochs: int  #: how often it saw them
    loops: int  #: hostile loops, all kinds together
    models: dict[Name, Refinement]  #: the network before and after, `deeponet` and `deeponet@refined`

    @field_validator("models")
    @classmethod
    def _rank(cls, models: dict[Contender, Refinement]) -> dict[Contender, Refinement]:
        return dict(zip(ranked(models), models.values(), strict=True))
