"""The result of `npred reproduce`, one per experiment."""

from npred.results.base import Result


class ReproducedRow(Result):
    """A published number, and the same quantity measured here."""

    predictor: str  #: `numerical`, or the network's name
    metric: str  #: the measured quantity
    published: float | None  #: as printed; null where the source prints none
    as_published: float | None  #: in the published loop, its errors included; null: not measured
    as_meant: float | None  #: with the right plant, law, transport and metric; null: not measured


class Reproduced(Result):
    """A published experiment: its rows."""

    name: str  #: the experiment
    rows: list[ReproducedRow]  #: one per predictor and metric
