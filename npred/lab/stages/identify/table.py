"""The table [identify]."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from npred.lab.config.section import Number, Positive, Section, Span, Switch


class Identify(Section):
    """Recordings of one plant for `npred identify`."""

    data: str | list[str] = ""  #: the recording, or several: CSV, or a format of an extra
    time: str | None = None  #: the column of the times; by default t, time, timestamp or stamp
    time_unit: str | None = None  #: unit of that column: s, ms, us, ns, min or h; by default from its header or kind
    period: Positive | None = None  #: time from row to row of a recording without times, in the plant's unit
    hold: Literal["zero", "linear"] | None = None  #: the input between two commands: the last one, or a line
    columns: dict[str, str] = {}  #: column of each input and output, if its name differs
    scale: dict[str, Number] = {}  #: factor of a column, to the plant's unit
    shift: dict[str, Number] = {}  #: then added to the column
    free: list[str] = []  #: parameters to estimate
    bounds: dict[str, Span] = {}  #: ranges of these parameters
    longest: Positive | None = None  #: longest delay to try; by default a fifth of the recording
    offset: Switch = False  #: estimate a constant offset of each input
    time_varying: Switch = False  #: also estimate delays over windows of time
    #: relative error of the other parameters; it widens the intervals
    model_error: Annotated[float, Field(ge=0, lt=1, strict=True)] = 0.05

    @property
    def files(self) -> list[Path]:
        return [Path(name) for name in ([self.data] if isinstance(self.data, str) else self.data) if name]

    def with_file_names(self) -> dict[str, Any]:
        """The keys that differ from their defaults, with the recordings in the current folder."""
        names = [path.name for path in self.files]
        return self.model_dump(exclude_defaults=True) | {"data": names[0] if len(names) == 1 else names}
