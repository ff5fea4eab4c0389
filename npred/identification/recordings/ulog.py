"""ULog of PX4. A name is a topic and a field: vehicle_attitude.rollspeed; sensor_gyro[1].x is of a second instance."""

from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
from pyulog import ULog

from npred.identification.recordings import Contents, TimeSeries, TimeSource, decoding, unknown


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

    def contents(self, names: Sequence[str], source: TimeSource) -> Contents:
        """The fields as they are. With `source.time`, a field of each message, this field gives the times."""
        series, time, count = {}, source.time or "timestamp", 0
        scale, unit = source.scale(self.path, source.time_unit if source.time else "us")
        for name in names:
            topic, _, field = name.partition(".")
            fields = self.topics.get(topic, {})
            for each in (field, time):
                if each not in fields:
                    raise unknown(self.path, f"{topic}.{each}", self.columns())
            stamps = fields[time].astype(float)  # exact: below 2^53 microseconds
            t = scale * (stamps if source.time else stamps - self.start)
            series[name] = TimeSeries(t, fields[field].astype(float), np.arange(1, len(t) + 1))
            count = max(count, len(t))
        return Contents(series, [f"{self.path.name}: {count} messages; times from {time}{unit}, in {source.unit}."])
