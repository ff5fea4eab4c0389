"""The table [tune]."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from npred.lab.config.section import Count, Delay, Section, Span

Margin = Annotated[float, Field(gt=0, lt=1, strict=True)]


class Tune(Section):
    """The search of `npred tune` in the loops of [evaluate].

    gamma and b vary if a delay law adapts. A range with low > 0 has a logarithmic scale; low = high fixes the number.
    """

    #: parameters that vary: those of kappa, not of f; of kappa = "lqr" also Q and R, their diagonals, or one as Q.x
    free: list[str] = []
    #: by name, of Q and R times the present; by default gamma, b, Q, R: 1 % to 100 times, gains: a fifth to 5 times
    bounds: dict[str, Span] = {}
    starts: Count = 8  #: random initial states of the search
    held_out: Annotated[int, Field(ge=2, le=2**53, strict=True)] = 16  #: initial states of the final judgement
    evaluations: Count = 150  #: number of settings to try
    effort: Delay = 0.1  #: weight of the control effort in the cost
    margin: Margin = 0.05  #: smallest gain that counts, as a share of the cost

    @model_validator(mode="after")
    def _check_bounds(self) -> Self:
        for name in self.bounds:
            if name not in (*self.free, "gamma", "b"):
                raise ValueError(f"bounds: expected gamma, b or a name of free, got {name!r}; add it to free")
        return self
