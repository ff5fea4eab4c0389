"""The predictors that results compare: the numerical one, with and without adaptation, each network and snapshot."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BeforeValidator, PlainSerializer

from npred.base.registry import NETWORKS

T = TypeVar("T")


@dataclass(frozen=True)
class PredictorId:
    """A predictor of a comparison; `epoch` is that of a snapshot, None for the final weights and for numerics.

    `rank` counts the networks of a result that are not built in, by name: what tells them apart in figures.
    """

    model: str
    epoch: int | None = None
    rank: int = field(default=0, compare=False)

    @classmethod
    def parse(cls, name: "str | PredictorId") -> "PredictorId":
        """The predictor of a name. Raises ValueError where what follows the @ is no epoch."""
        if isinstance(name, PredictorId):
            return name
        model, at, epoch = name.rpartition("@")
        if at and not (epoch.isascii() and epoch.isdigit()):
            raise ValueError(f"expected an epoch after @, got {epoch!r}; for example deeponet@107")
        return cls(model, int(epoch)) if at else cls(name)

    @property
    def name(self) -> str:
        """Its name in results: deeponet@107, numerical, no_adaptation."""
        return self.model if self.epoch is None else f"{self.model}@{self.epoch}"

    @property
    def label(self) -> str:
        """Its label for people: DeepONet, epoch 107."""
        label = NETWORKS.label(self.model) if self.is_network else self.model.replace("_", " ")
        return label if self.epoch is None else f"{label}, epoch {self.epoch}"

    @property
    def is_network(self) -> bool:
        """True if a network predicts."""
        return self not in (NUMERICAL, NO_ADAPTATION)

    @property
    def adapts(self) -> bool:
        """True if D_hat follows the delay law; without adaptation it stays at D_hat(0)."""
        return self != NO_ADAPTATION


def ranked(predictors: Iterable[PredictorId]) -> list[PredictorId]:
    """The same predictors with the ranks that they have beside each other."""
    predictors = list(predictors)
    others = sorted({c.model for c in predictors if c.is_network} - NETWORKS.builtin.keys())
    return [replace(c, rank=others.index(c.model)) if c.model in others else c for c in predictors]


def _by_ranked(values: dict[PredictorId, T]) -> dict[PredictorId, T]:
    return dict(zip(ranked(values), values.values(), strict=True))


NUMERICAL, NO_ADAPTATION = PredictorId("numerical"), PredictorId("no_adaptation")
Name = Annotated[PredictorId, BeforeValidator(PredictorId.parse), PlainSerializer(lambda c: c.name, return_type=str)]
RANKED = AfterValidator(_by_ranked)  # of a table by Name
