"""The table [certify]."""

from typing import Annotated

from pydantic import Field

from npred.lab.config.section import Count, Section


class Certify(Section):
    """Tests of `npred certify`: with `confidence`, at most the share `probability` of all rollouts errs by more."""

    probability: Annotated[float, Field(gt=0, lt=1, strict=True)] = 1e-3  #: share of rollouts with a larger error
    confidence: Annotated[float, Field(gt=0, lt=1, strict=True)] = 0.999  #: confidence of that statement
    samples: Count = 50  #: random times of each rollout
    restarts: Count = 500  #: searches for large errors …
    steps: Count = 200  #: … with this number of calls each
    loops: Count = 40  #: fresh starts
