"""The result of `npred reproduce`, one per experiment."""

from npred.results.base import Result


class ReproducedRow(Result):
    """A published number, and the same quantity measured here."""

    predictor: str  #: `numerical`, or the network's name
    metric: str  #: the measured quantity
    published: float | None  #: as printed; null where the source prints none
    as_published: float | None  #: in the published loop, its errors included; null: not measured
    as_meant: float | None  #: with the right plant, law, transport and metric; null: not measured


class TrainedForLoop(Result):
    """A network that was trained for one of an experiment's two loops."""

    network: str  #: fno, deeponet, fno_gru or deeponet_gru
    loop: str  #: `as published` or `as meant`
    parameters: int  #: its weights
    samples: int  #: rows that it learned from
    epochs: int  #: passes over them
    loss: float  #: the last, of training
    mse: float  #: mean square error of P on rollouts that were held out
    eps_sup: float  #: largest error of P there
    seconds: float  #: of training, the samples' included
    ms: float  #: milliseconds of one prediction, compiled: the median of single calls


class PredictionTime(Result):
    """The time of one prediction, as printed and as measured here."""

    predictor: str  #: `numerical`, or the network's name
    setting: str  #: what is computed: the method and its steps
    published_ms: float | None = None  #: as printed; null where the source prints none
    ms: float | None = None  #: milliseconds here, compiled: the median of single calls; null: not measured
    error: float | None = None  #: sup |P_hat - P| of these calls at the end of the delay


class Reproduced(Result):
    """A published experiment: its rows."""

    name: str  #: the experiment
    rows: list[ReproducedRow]  #: one per predictor and metric
    trained: list[TrainedForLoop] = []  #: the networks behind the rows
    times: list[PredictionTime] = []  #: of single predictions
