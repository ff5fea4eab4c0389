"""The table [generate]."""

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from npred.config.loop import Loop
from npred.config.section import ADDED, Count, Delay, Positive, Range, Some, Span


class Generate(Loop):
    """Rollouts with the numerical predictor and the samples taken from them.

    The share `explore` of the rollouts, the last ones, takes its delays from explore_D and explore_D_hat0: they widen
    what a network is trained on, and all of them are trained on. So does the share `redraw` of all rows to train on:
    their D_hat is drawn from explore_D_hat0 instead of the loop's, and P is the numerical predictor's for it. With
    `spread` their X and u are moved off the loop too, near it and farther away: where the delay is known the loops of
    the exact prediction run along one curve, and a network's own loops beside it. The evaluation makes more rollouts
    and rows of both kinds, which no network has seen, and reports their errors apart.
    `data` is an HDF5 file with these samples, as `npred import` and `npred export hdf5` write it: nothing is simulated.
    """

    follows: ClassVar = ("D_hat0", "explore_D", "explore_D_hat0")

    samples: Count = 5000  #: rows of data
    rollouts: Count = 50  #: loops that they are taken from
    D: Range | Positive = 1.0  #: true delay in seconds, or a range to draw it from
    #: ranges of D_hat(0), an equal share of rollouts each; times D
    D_hat0: Some[Range] = [(0.3, 0.7), (1.0, 2.0), (1.0, 2.0)]
    box: dict[str, Span] = {}  #: range of each initial state of the data, instead of the plant's
    test_share: Annotated[float, Field(gt=0, lt=1)] = 0.1  #: of the rollouts, held out
    explore: Annotated[float, Field(ge=0, lt=1)] = 0.0  #: share of rollouts with delays from explore_D, explore_D_hat0
    redraw: Annotated[float, Field(ge=0, lt=1)] = 0.0  #: share of rows with a D_hat drawn anew
    #: how far redrawn rows are off the loop at most, in standard deviations of X and of u on it
    spread: Annotated[Delay, ADDED] = 0.0
    explore_D: Range = (0.25, 2.0)  #: D of exploring rollouts; times D
    explore_D_hat0: Range = (0.25, 3.5)  #: D_hat(0) of those, and D_hat of redrawn rows; times D
    data: str = ""  #: an HDF5 file of samples instead of rollouts

    @property
    def explorers(self) -> int:
        """The number of rollouts that explore: at least two are left for training and test."""
        return min(round(self.explore * self.rollouts), self.rollouts - 2)

    @model_validator(mode="after")
    def _check_explorers(self) -> Self:
        if self.explore:
            self.reached("explore_D", self.explore_D)
        if self.explore or self.redraw:
            self.reached("explore_D_hat0", self.explore_D_hat0)
        return self

    @model_validator(mode="after")
    def _check_delays(self) -> Self:
        for k, span in enumerate(self.D_hat0):
            self.reached(f"D_hat0[{k}]", span)
        self.reached("D", self.D if isinstance(self.D, tuple) else (self.D, self.D))
        if self.rollouts < 2:
            raise ValueError("rollouts: expected at least 2, got 1; one is held out for the test")
        if not self.rollouts <= self.samples <= self.rollouts * round(self.t_end / self.dt):
            raise ValueError(
                f"samples: expected 1 to t_end / dt per rollout, got {self.samples} of {self.rollouts}; change either"
            )
        return self
