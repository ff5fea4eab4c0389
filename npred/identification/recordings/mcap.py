"""MCAP: messages as JSON, or of ROS 2."""

import json
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mcap.decoder import DecoderFactory
from mcap.reader import make_reader
from mcap.records import Schema

from npred.base.errors import ConfigError, required
from npred.identification.recordings.messages import Bag, Topics


class Mcap(Topics):
    """An .mcap file."""

    what = "an MCAP file"

    @contextmanager
    def bag(self) -> Iterator[Bag]:
        """The opened file; without an index all of it is read for its topics."""
        with self.path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[Decoders(self.path)])
            summary = reader.get_summary()
            if summary and summary.channels and summary.statistics:
                topics, start = {c.topic for c in summary.channels.values()}, summary.statistics.message_start_time
            else:
                every = [(channel.topic, message.log_time) for _, channel, message in reader.iter_messages()]
                topics, start = {topic for topic, _ in every}, min((time for _, time in every), default=0)

            def messages(topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
                for decoded in reader.iter_decoded_messages(list(topics)):
                    yield decoded.channel.topic, decoded.message.log_time, decoded.decoded_message

            yield Bag(topics, start, messages)


class Decoders(DecoderFactory):
    """JSON by Python, CDR by the package mcap-ros2-support."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Callable[[bytes], Any]:
        """The decoder of a channel. Raises ConfigError for other encodings, MissingError without the package."""
        if message_encoding == "json":
            return json.loads
        decoder = None
        if message_encoding == "cdr":
            ros2 = required("recording mcap: ROS 2", "mcap_ros2.decoder", "mcap-ros2-support", "mcap")
            decoder = ros2.DecoderFactory().decoder_for(message_encoding, schema)
        if decoder is None:
            got = f"{message_encoding} with the schema {schema.name if schema else 'none'}"
            raise ConfigError(f"{self.path}: expected messages as JSON or of ROS 2 (CDR), got {got}; convert them")
        return decoder
