"""The table [identify]."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from npred.lab.config.section import Positive, Section, Span


class Identify(Section):
    """A recording for `npred identify`."""

    data: str = ""  #: the recording: CSV, or a format of an extra
    time: str | None = None  #: the column of the times; by default t, time, timestamp or stamp
    time_unit: str | None = None  #: s, ms, us, ns, min or h; by default from the header, else s
    columns: dict[str, str] = {}  #: column of each input and output, if its name differs
    scale: dict[str, float] = {}  #: factor of a column, to the plant's unit
    shift: dict[str, float] = {}  #: then added to the column
    free: list[str] = []  #: parameters to estimate
    bounds: dict[str, Span] = {}  #: ranges of these parameters
    longest: Positive | None = None  #: longest delay to try; by default a fifth of the recording
    offset: bool = False  #: estimate a constant offset of each input
    time_varying: bool = False  #: also estimate delays over windows of time
    #: relative error of the other parameters; it widens the intervals
    model_error: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.05

    def with_file_names(self) -> dict[str, Any]:
        """The keys that differ from their defaults, with the recording in the current folder."""
        return self.model_dump(exclude_defaults=True) | {"data": Path(self.data).name}
