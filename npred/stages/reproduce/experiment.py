"""What an experiment is: what was published, and a function that measures it again."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

NUMERICAL = "numerical"


class PublishedNumber(NamedTuple):
    """A published number, digits as printed; empty where the source prints none."""

    metric: str
    digits: str
    predictor: str = NUMERICAL

    @property
    def value(self) -> float | None:
        """The number, None where none is printed."""
        return float(self.digits) if self.digits else None


class Measured(NamedTuple):
    """The same quantity in the published loop, its errors included, and in the loop as the article means it."""

    as_published: float | None
    as_meant: float | None


Measurements = Mapping[str, Measured]


@dataclass(frozen=True)
class Experiment:
    """A published experiment; `measure` has the numerical predictor's numbers by metric, in seconds of work.

    `networks` has what was published for networks; nobody has trained those here, so nothing stands beside them.
    """

    title: str
    source: str
    numerical: tuple[PublishedNumber, ...]
    measure: Callable[[], Measurements]
    networks: tuple[PublishedNumber, ...] = ()


def networks(metric: str, **digits: str) -> tuple[PublishedNumber, ...]:
    """The published numbers of networks by name, for one metric."""
    return tuple(PublishedNumber(metric, printed, name) for name, printed in digits.items())
