"""Bags of ROS 1 (.bag) and of ROS 2, a folder with metadata.yaml; a .db3 file of it stands for the folder."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from npred.identification.recordings.messages import Bag, Topics


class Rosbag(Topics):
    """A bag of either. One without definitions of its messages is read by those of the latest ROS 2."""

    what = "a bag of ROS"

    @contextmanager
    def bag(self) -> Iterator[Bag]:
        folder = self.path.suffix == ".db3" and (self.path.parent / "metadata.yaml").exists()
        path = self.path.parent if folder else self.path
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:

            def messages(topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
                connections = [c for c in reader.connections if c.topic in topics]
                for connection, time, data in reader.messages(connections) if connections else ():
                    yield connection.topic, time, reader.deserialize(data, connection.msgtype)

            yield Bag({c.topic for c in reader.connections}, reader.start_time, messages)
