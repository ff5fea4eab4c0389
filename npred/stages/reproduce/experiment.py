"""What an experiment is: what was published, and functions that measure it again."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from npred.results.reproduce import PredictionTime, TrainedForLoop
    from npred.stages.reproduce.network_loop import NetworkLoop

NUMERICAL, NETWORKS = "numerical", ("fno", "deeponet", "fno_gru", "deeponet_gru")  # what predicts
TIMES = "times"  # the part of an experiment that times predictions
AS_PUBLISHED, AS_MEANT = "as published", "as meant"


class PublishedNumber(NamedTuple):
    """A published number, digits as printed; empty where the source prints none."""

    metric: str
    digits: str
    predictor: str = NUMERICAL

    @property
    def value(self) -> float | None:
        """The number, None where none is printed."""
        return float(self.digits) if self.digits else None


class PublishedTime(NamedTuple):
    """The milliseconds of one prediction as printed, and of what: `100 steps`, say."""

    predictor: str
    setting: str
    ms: float


class Measured(NamedTuple):
    """The same quantity in the published loop, its errors included, and in the loop as the article means it."""

    as_published: float | None
    as_meant: float | None


Measurements = Mapping[str, Measured]
Learn = Callable[[Path, Path, Any], tuple[Mapping[str, float], "TrainedForLoop"]]
"""Trains a network. Of its files' folder, its checkpoint's folder and progress: its metrics, and how it was trained."""


@dataclass(frozen=True)
class Experiment:
    """A published experiment; `measure` has the numerical predictor's numbers by metric, in seconds of work.

    `networks` has what was published for networks. `loops`: the loop as published and as it is meant, each of which
    asks any predictor, so that networks can be trained for both and put there. `sizes` are keys of the networks'
    tables that differ from those of npred.stages.reproduce.learning. `learn` trains the networks of an experiment that
    asks for something else than predictions; its metrics are the same in both loops. `times` has published times of one
    prediction, and the first of each network is the one beside npred's; `clock` takes those of numerical predictors.
    """

    title: str
    source: str
    numerical: tuple[PublishedNumber, ...]
    measure: Callable[[], Measurements]
    networks: tuple[PublishedNumber, ...] = ()
    loops: "Mapping[str, NetworkLoop]" = field(default_factory=dict)
    sizes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    learn: Learn | None = None
    times: tuple[PublishedTime, ...] = ()
    clock: "Callable[[], list[PredictionTime]] | None" = None

    @property
    def trained(self) -> list[str]:
        """The networks that are trained here: those with rows, where there is a loop or another training for them."""
        return list(dict.fromkeys(row.predictor for row in self.networks)) if self.loops or self.learn else []

    @property
    def parts(self) -> list[str]:
        """What is measured apart from each other, each a result in the store."""
        return [NUMERICAL, *([TIMES] if self.clock else []), *self.trained]


def networks(metric: str, **digits: str) -> tuple[PublishedNumber, ...]:
    """The published numbers of networks by name, for one metric."""
    return tuple(PublishedNumber(metric, printed, name) for name, printed in digits.items())


def published_times(setting: str, **ms: float) -> tuple[PublishedTime, ...]:
    """The published times of predictors by name, for one setting."""
    return tuple(PublishedTime(name, setting, each) for name, each in ms.items())
