"""The result of the stage identify."""

from npred.lab.config.results.base import Number, Result


class IdentifiedResult(Result):
    """Delays and parameters from a recording. Times are in the plant's unit."""

    plant: str  #: its name
    inputs: list[str]  #: its inputs, in the order of D
    D: list[float]  #: the delay of each input
    interval: list[tuple[float, float]]  #: of each delay, 95 %
    identifiable: list[bool]  #: whether the recording determines the delay
    parameters: dict[str, float]  #: the estimated ones
    parameter_intervals: dict[str, tuple[Number, Number]]  #: of each parameter, 95 %
    #: rms error of predictions on the last quarter: `model`, `no_delay`, `first_order_lag`
    held_back: dict[str, Number]
    sentences: list[str]  #: the result in words
    samples: int  #: number of output samples
    period: float  #: the median time between two samples
    windows: dict[str, list[float | list[float] | list[tuple[float, float]]]] | None = None  #: t, D, interval
