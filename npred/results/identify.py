"""The result of the stage identify."""

from npred.results.base import Number, Result


class IdentifiedResult(Result):
    """What a recording tells of a plant; times are in the plant's unit."""

    plant: str  #: its name
    inputs: list[str]  #: its inputs, in the order of D
    D: list[float]  #: the delay of each input
    interval: list[tuple[float, float]]  #: of each, with 95 %
    identifiable: list[bool]  #: whether the recording tells it
    parameters: dict[str, float]  #: those that were free
    parameter_intervals: dict[str, tuple[Number, Number]]  #: of each, with 95 %
    #: the rms error of predictions on the last quarter: of the `model`, with `no_delay`, and with a `first_order_lag`
    held_back: dict[str, Number]
    sentences: list[str]  #: all of it in words
    samples: int  #: of outputs
    period: float  #: the median time between two samples
    windows: dict[str, list[float | list[float] | list[tuple[float, float]]]] | None = None  #: t, D and interval
