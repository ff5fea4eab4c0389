"""The base class of results: the keys that a stage writes and no others, and null for a number that is not finite.

And the results of the stages generate, train and report, which are short.
"""

import math
import reprlib
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainSerializer, ValidationError

from npred.base import json_files, notebook
from npred.base.defaults import RESULT
from npred.base.errors import StoreError


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
        """The values by key without those that are absent: what another result takes over."""
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
            raise StoreError(
                f"{source}: expected a result as this npred writes it, got at {key}: {first['msg']}; make it anew with "
                "npred run, or show it with the npred that wrote it"
            ) from None


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

    summary: list[str]  #: three sentences: the error, the closed loop, the time of a call
    bytes: int  #: of the page
