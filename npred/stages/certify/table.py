"""The table [certify]."""

from typing import Annotated

from pydantic import Field

from npred.config.section import Count, Section


class Certify(Section):
    """What `npred certify` draws and searches: N rollouts such that with `confidence` at most a share `probability` of
    all has a larger error than the largest of these; an adversary's calls; and loops that are counted as lost.
    """

    probability: Annotated[float, Field(gt=0, lt=1, strict=True)] = 1e-3  #: share of rollouts that may be worse
    confidence: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.999  #: with which that holds
    samples: Count = 50  #: of each rollout, at random times
    restarts: Count = 500  #: searches for the largest error, and for errors that the guard lets pass …
    steps: Count = 200  #: … of so many calls each
    loops: Count = 40  #: fresh starts, each with the numerical predictor, the bare network and the guarded one
