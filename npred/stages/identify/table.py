"""The table [identify]."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from npred.config.section import Positive, Section, Span


class Identify(Section):
    """A recording, and what `npred identify` looks for in it."""

    data: str = ""  #: the recording: CSV, or a format of an extra
    time: str | None = None  #: the column of the times; by default t, time, timestamp or stamp
    time_unit: str | None = None  #: of that column: s, ms, us, ns, min or h; by default its header says, else s
    columns: dict[str, str] = {}  #: inputs and outputs of the plant to columns, where these have other names
    scale: dict[str, float] = {}  #: what a column is multiplied by, to have the plant's unit
    shift: dict[str, float] = {}  #: what is added to it then
    free: list[str] = []  #: parameters of the plant that are estimated
    bounds: dict[str, Span] = {}  #: ranges of free parameters
    longest: Positive | None = None  #: the longest delay that is tried; by default a fifth of the recording
    offset: bool = False  #: whether a constant is added to each input, and estimated
    time_varying: bool = False  #: whether delays are estimated over windows of time, too
    #: how far parameters that are not free may be from their values, relatively: it widens the intervals
    model_error: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.05

    def beside(self) -> dict[str, Any]:
        """What is not left at its default, the recording being in the current folder."""
        return self.model_dump(exclude_defaults=True) | {"data": Path(self.data).name}
