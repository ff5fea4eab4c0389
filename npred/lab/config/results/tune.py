"""The result of `npred tune`."""

from npred.lab.config.results.base import Number, Result


class TunedNumber(Result):
    """A number of the loop that was free."""

    name: str  #: gamma, b or a parameter of the plant
    before: float  #: the pipeline's
    after: float  #: that of the best cost on the training starts
    low: float  #: lower end of its range
    high: float  #: upper end


class JudgedLoops(Result):
    """Loops from the same starts under the same conditions, before and after."""

    loops: int  #: how many
    cost: tuple[Number, Number]  #: mean over the loops
    settle_time: tuple[Number | None, Number | None]  #: mean of those that settle, in the plant's unit; null for none
    unsettled: tuple[int, int]  #: how many do not settle


class Tuned(Result):
    """What was gained; pairs are before, after."""

    pipeline: str  #: its name
    plant: str  #: its name
    numbers: list[TunedNumber]  #: that were free
    training: JudgedLoops  #: from the starts of the search
    held_out: JudgedLoops  #: from others
    gain: float  #: 1 - cost after / cost before on the held-out starts
    interval: tuple[float, float]  #: of the gain with 95 %: bootstrap over the held-out initial states, in pairs
    margin: float  #: least gain that counts
    gained: bool  #: the gain reaches the margin, and its interval is above 0
    evaluations: int  #: settings that were tried
    interrupted: bool  #: the search was ended before all were
    sentence: str  #: the answer
