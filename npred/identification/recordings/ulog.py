"""ULog of PX4. A name is a topic and a field: vehicle_attitude.rollspeed; sensor_gyro[1].x is of a second instance."""

from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

from pyulog import ULog

from npred.identification.recordings import UNITS, TimeSeries, decoding, unknown

MICROSECONDS = 1e-6


class Ulog:
    """A .ulg file. Times are from its begin on."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with decoding(path, "a ULog file"), redirect_stdout(None):  # damage is printed there
            log = ULog(str(path))
        self.start, self.topics = log.start_timestamp, {}
        for each in log.data_list:
            self.topics[f"{each.name}[{each.multi_id}]" if each.multi_id else each.name] = each.data

    def columns(self) -> list[str]:
        """Topic and field of every number."""
        return [f"{topic}.{field}" for topic, fields in self.topics.items() for field in fields]

    def series(self, names: Sequence[str], time: str | None, unit: str | None) -> dict[str, TimeSeries]:
        """The fields as they are. With `time`, a field of each message, this field gives the times, in that unit."""
        series = {}
        for name in names:
            topic, _, field = name.partition(".")
            fields = self.topics.get(topic, {})
            for each in (field, time or "timestamp"):
                if each not in fields:
                    raise unknown(self.path, f"{topic}.{each}", self.columns())
            stamps = fields[time or "timestamp"].astype(float)  # exact: below 2^53 microseconds
            t = stamps * UNITS[unit or "s"] if time else (stamps - self.start) * MICROSECONDS
            series[name] = TimeSeries(t, fields[field].astype(float))
        return series
