"""The table [tune]."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from npred.config.section import Count, Delay, Section, Span

Margin = Annotated[float, Field(gt=0, lt=1, strict=True)]


class Tune(Section):
    """What `npred tune` varies in the loops of [evaluate], and how it judges.

    gamma and b vary where a delay law adapts. A range with low > 0 is searched on a logarithmic scale, and one with
    low = high holds its number.
    """

    free: list[str] = []  #: parameters of the plant that vary: those that kappa reads, and the plant's motion does not
    bounds: dict[
        str, Span
    ] = {}  #: ranges by name; by default gamma and b from 1 % to 100 times, gains a fifth to 5 times
    starts: Count = 8  #: random initial states of the search, each times case_D_hat0, in each scenario
    held_out: Annotated[int, Field(ge=2, le=2**53, strict=True)] = 16  #: other initial states, which judge
    evaluations: Count = 150  #: how many settings are tried
    effort: Delay = 0.1  #: weight of the control effort in the cost
    margin: Margin = 0.05  #: least share of the cost to gain; with less there is nothing to gain

    @model_validator(mode="after")
    def _check_bounds(self) -> Self:
        for name in self.bounds:
            if name not in (*self.free, "gamma", "b"):
                raise ValueError(f"bounds: expected gamma, b or a name of free, got {name!r}; add it to free")
        return self
