"""A published experiment: its printed numbers, functions that measure it again, and the rows that they give.

A package registers one by an entry point of the group `npred.experiments`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from npred.lab.config.results import Result
from npred.lab.report.terminal.console import Console
from npred_experiments import EXPERIMENTS

NUMERICAL = "numerical"  # what predicts
TIMES = "times"  # the part of an experiment that times predictions
CORRECTED = {"fno_gru": "FNO + GRU", "deeponet_gru": "DeepONet + GRU"}  # published beside the built-in networks
AS_PUBLISHED, AS_MEANT = "as published", "as meant"


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
    seconds: float  #: time of training, the samples' included
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
    times: list[PredictionTime] = []  #: times of single predictions


class Measured(NamedTuple):
    """The same quantity in the published loop, its errors included, and in the loop as the article means it."""

    as_published: float | None = None
    as_meant: float | None = None


NOTHING = Measured()


class PublishedNumber(NamedTuple):
    """A published number, digits as printed; empty where the source prints none."""

    metric: str
    digits: str
    predictor: str = NUMERICAL

    @property
    def value(self) -> float | None:
        """The number, None where none is printed."""
        return float(self.digits) if self.digits else None

    def row(self, measured: Measured = NOTHING) -> ReproducedRow:
        """The number and the measured one; None for a loop that has left the finite numbers."""
        pairs = measured._asdict().items()
        values = {key: value if value is not None and math.isfinite(value) else None for key, value in pairs}
        return ReproducedRow(predictor=self.predictor, metric=self.metric, published=self.value, **values)


class PublishedTime(NamedTuple):
    """The milliseconds of one prediction as printed, and its method: `100 steps`, say."""

    predictor: str
    setting: str
    ms: float


class Place(NamedTuple):
    """Where a network's files go, the folder of checkpoints that outlives an interruption, and who shows progress."""

    folder: Path
    scratch: Path
    progress: Console


Measurements = Mapping[str, Measured]
Train = Callable[[str, str, Place], tuple[Mapping[str, Mapping[str, float]], Sequence[TrainedForLoop]]]
"""Trains a network. Of the names of the experiment and of the network, and of its place: the metrics by loop, `as
published` and `as meant`, and how the network was trained for each."""


@dataclass(frozen=True)
class Experiment:
    """A published experiment; `measure` has the numerical predictor's numbers by metric, in seconds of work.

    `networks` has what was published for networks; `train` puts a network of npred's in their place. `times` has
    published times of one prediction, and the first of each network is the one beside npred's; `clock` takes those of
    numerical predictors.
    """

    title: str
    source: str
    numerical: tuple[PublishedNumber, ...]
    measure: Callable[[], Measurements]
    networks: tuple[PublishedNumber, ...] = ()
    train: Train | None = None
    times: tuple[PublishedTime, ...] = ()
    clock: Callable[[], list[PredictionTime]] | None = None

    @property
    def parts(self) -> list[str]:
        """The parts that are measured apart from each other, each a result in the store."""
        networks = dict.fromkeys(row.predictor for row in self.networks) if self.train else ()
        return [NUMERICAL, *([TIMES] if self.clock else []), *networks]

    def measured(self, name: str, part: str, place: Place) -> Reproduced:
        """A part, measured now: the numerical rows, the times of numerical predictors, or the rows of a network."""
        if part == NUMERICAL:
            values = self.measure()
            return Reproduced(name=name, rows=[row.row(values[row.metric]) for row in self.numerical])
        if part == TIMES:
            return Reproduced(name=name, rows=[], times=self.clock() if self.clock else [])
        metrics, trained = self.train(name, part, place) if self.train else ({}, [])
        published, meant = (metrics.get(loop, {}) for loop in (AS_PUBLISHED, AS_MEANT))
        rows = [
            row.row(Measured(published.get(row.metric), meant.get(row.metric)))
            for row in self.networks
            if row.predictor == part
        ]
        return Reproduced(name=name, rows=rows, trained=list(trained))


def load(name: str) -> Experiment:
    """The experiment of that name. Raises ConfigError, in one line, for another name."""
    return EXPERIMENTS.load("reproduce", name)


def networks(metric: str, **digits: str) -> tuple[PublishedNumber, ...]:
    """The published numbers of networks by name, for one metric."""
    return tuple(PublishedNumber(metric, printed, name) for name, printed in digits.items())


def published_times(setting: str, **ms: float) -> tuple[PublishedTime, ...]:
    """The published times of predictors by name, for one setting."""
    return tuple(PublishedTime(name, setting, each) for name, each in ms.items())
