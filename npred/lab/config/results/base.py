"""The base class of results: the keys that a stage writes and no others, and null for a number that is not finite.

And the predictors that results compare, and the results of generate, train, report, identify and `npred tune`.
"""

import math
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, PlainSerializer, ValidationError

from npred.base import json_files, notebook
from npred.base.defaults import RESULT
from npred.base.errors import StoreError
from npred.base.registry import NETWORKS
from npred.lab.config import section

T = TypeVar("T")


def _number(value: Any) -> Any:
    try:
        return value if value is not None and math.isfinite(value) else math.inf
    except (TypeError, OverflowError):  # for pydantic to refuse
        return value


def _null(value: float) -> float | None:
    return value if math.isfinite(value) else None


# JSON has no infinity. So null is one here; where null means that there is none, a field is `float | None` instead.
Number = Annotated[float, BeforeValidator(_number), PlainSerializer(_null)]


class Result(BaseModel):
    """A table of a stage's result. A key that the stage leaves out stays out of the JSON; an unknown one is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def json_object(self) -> dict[str, Any]:
        """The JSON object, as result.json holds it."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)

    def _repr_html_(self) -> str:
        """A line for each key in a notebook, long values cut."""
        return notebook.preformatted("\n".join(f"{key}: {reprlib.repr(value)}" for key, value in self))

    @property
    def set_values(self) -> dict[str, Any]:
        """The values by key without those that are absent, for another result to take over."""
        return {key: getattr(self, key) for key in self.model_fields_set}

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The result in an artifact's folder. Raises StoreError where its file is none, or does not fit."""
        path = folder / RESULT
        try:
            return cls.of(json_files.table(path), path)
        except (OSError, ValueError) as error:
            raise StoreError(f"{path}: expected a result as JSON, got: {error}; remove {folder}, run again") from None

    @classmethod
    def of(cls, document: dict[str, Any], source: object) -> Self:
        """The result of that JSON object, which came from `source`. Raises StoreError where it does not fit."""
        try:
            return cls.model_validate(document)
        except ValidationError as error:
            first = error.errors()[0]
            key = json_files.escaped(".".join(str(part) for part in first["loc"]))
            came = "none" if first["type"] == "missing" else reprlib.repr(first["input"])
            there = f"no {key}" if first["type"] == "extra_forbidden" else f"at {key} {section.expected(first)[0]}"
            what = f"{source}: expected a result as this npred writes it, {there}"
            cure = "make it anew with npred run, or show it with the npred that wrote it"
            raise StoreError(f"{what}, got {came}; {cure}") from None


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
        """The predictor of a name. Raises ValueError where no epoch follows the @."""
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


NUMERICAL, NO_ADAPTATION = PredictorId("numerical"), PredictorId("no_adaptation")
Name = Annotated[PredictorId, BeforeValidator(PredictorId.parse), PlainSerializer(lambda c: c.name, return_type=str)]
RANKED = AfterValidator(lambda values: dict(zip(ranked(values), values.values(), strict=True)))  # for a table by Name


class Generated(Result):
    """The data."""

    samples: int  #: rows of data
    rollouts: int  #: closed loops of these rows
    held_out: list[int]  #: numbers of the held-out rollouts
    nx: int  #: nodes on [0, 1]
    shards: int = 0  #: number of data files, if there are several


class Trained(Result):
    """A trained network. The errors are of the last epoch, on held-out rollouts."""

    model: str  #: the network's name
    parameters: int  #: number of weights
    samples: int  #: training rows
    epochs: int  #: passes over these rows
    loss: Number  #: the last epoch's
    mse: Number  #: mean square error
    eps_sup: Number  #: largest |P̂ − P|


class Reported(Result):
    """The page."""

    #: three sentences: the error, the closed loop, the time of a call; a caution first where no network is good
    summary: list[str]
    bytes: int  #: size of the page


class IdentifiedResult(Result):
    """Delays and parameters from a recording. Times are in the plant's unit."""

    plant: str  #: its name
    inputs: list[str]  #: its inputs, in the order of D
    D: list[float]  #: the delay of each input
    interval: list[tuple[Number, Number]]  #: 95 % interval of each delay
    identifiable: list[bool]  #: whether the recording determines the delay
    parameters: dict[str, float]  #: the estimated ones
    parameter_intervals: dict[str, tuple[Number, Number]]  #: 95 % interval of each parameter
    #: rms error of predictions on the last quarter: `model`, and the rivals `no_delay`, `first_order_lag`,
    #: `lag_and_delay`, `static`
    held_back: dict[str, Number]
    held_back_unit: str = ""  #: the output's, or `standard deviations of the outputs`
    sentences: list[str]  #: the result in words
    refused: bool  #: whether the recording contradicts the model, or is of a closed loop without a test signal
    ranges: dict[str, tuple[float, float]]  #: lowest and highest sample of each output that was measured
    samples: int  #: number of output samples
    period: float  #: the median time between two samples
    windows: dict[str, list[Any]] | None = None  #: t, D and interval of each; if asked for, or if they differ


class TunedNumber(Result):
    """A number of the loop that was free."""

    name: str  #: gamma, b or a parameter of the plant
    before: float  #: the pipeline's
    after: float  #: the number with the lowest cost on the training starts
    low: float  #: lower end of its range
    high: float  #: upper end


class BeforeAfter(Result):
    """A mean over loops, before and after; null where no loop has it."""

    before: Number | None  #: the pipeline's
    after: Number | None  #: with the new numbers
    gain: Number | None  #: 1 - after / before
    interval: tuple[Number, Number] | None  #: 95 % interval of the gain: bootstrap over the initial states, in pairs

    @property
    def falls(self) -> bool:
        """True if it clearly falls: the interval is above 0."""
        return self.interval is not None and self.interval[0] > 0

    def change(self) -> str:
        """`falls by 41.7% (39.9% to 43.3%)`, or that it does not clearly change."""
        if self.gain is None or self.interval is None:
            return "has no clear change"
        low, high = self.interval
        if low <= 0 <= high:
            return f"has no clear change ({-high:+.1%} to {-low:+.1%})"
        verb, ends = ("falls", (low, high)) if low > 0 else ("rises", (-high, -low))
        return f"{verb} by {abs(self.gain):.1%} ({ends[0]:.1%} to {ends[1]:.1%})"


class JudgedLoops(Result):
    """Loops from the same starts under the same conditions; all but the cost of those that settle before and after."""

    loops: int  #: how many
    cost: BeforeAfter  #: of all loops
    settle_time: BeforeAfter  #: in the plant's unit of time
    peak: BeforeAfter  #: largest |X - X*|, in the plant's units
    effort: BeforeAfter  #: ∫ |U - U*|² dt
    unsettled: tuple[int, int]  #: how many do not settle, before and after


class Tuned(Result):
    """The best numbers, and whether they are a gain."""

    pipeline: str  #: its name
    plant: str  #: its name
    numbers: list[TunedNumber]  #: the free numbers
    training: JudgedLoops  #: loops from the starts of the search
    held_out: JudgedLoops  #: loops from other starts
    margin: float  #: least gain that counts
    #: the cost clearly falls by the margin, and with it settling time, effort, or the loops that do not settle
    gained: bool
    evaluations: int  #: settings that were tried
    interrupted: bool  #: whether the search was stopped before all were tried
    sentence: str  #: the answer
