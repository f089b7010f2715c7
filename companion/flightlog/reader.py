"""Reads a flight log, also one that was cut off."""

import logging
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, TypeVar

import cv2
import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.reader import McapReader, NonSeekingReader, SeekingReader
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from zstandard import ZstdError

from companion.flightlog.records import METADATA_NAME, CompressedImage, FlightMetadata, Topic
from companion.flightlog.schema import nan_restorer, table
from companion.kernel.errors import RecordingError
from companion.kernel.messages import StereoFrame

T = TypeVar("T", bound=msgspec.Struct)

DAMAGE = (McapError, ZstdError, struct.error, ValueError, OverflowError, MemoryError)
"""What the MCAP reader raises where the bytes end or make no sense."""
NONSENSE = (
    msgspec.MsgspecError, AttributeError, LookupError, OverflowError, RecursionError, TypeError,
    ValueError,
)  # fmt: skip
"""What comes of a record that is not one: damaged JSON, or other JSON than was declared."""

log = logging.getLogger(__name__)


class FlightLog:
    """One log. ``truncated`` says that its end is missing: all up to there can be read.

    Raises RecordingError, here and while reading, for a file that is no flight log.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truncated = False
        self.metadata = self._read_metadata()
        self._counts = self._count_records()
        if self.truncated:
            log.warning("%s: cut off; read as far as it goes", path)

    def topics(self) -> dict[str, int]:
        """Number of records by topic."""
        return dict(self._counts)

    def read(self, topic: str, kind: type[T]) -> Iterator[T]:
        """The records of a topic in the order they were written."""
        self._require(topic)
        restore = nan_restorer(kind)
        for _, message in self._messages({topic}):
            try:
                yield msgspec.convert(restore(msgspec.json.decode(message.data)), kind)
            except NONSENSE as error:
                raise RecordingError(
                    f"{self.path}: {topic}: not a {kind.__name__}: {error}"
                ) from error

    def columns(self, topic: str) -> dict[str, NDArray[Any]]:
        """A topic as a table: (n,) per field, (n, k) for vectors; null is NaN."""
        self._require(topic)
        messages = self._messages({topic})
        try:
            return table([msgspec.json.decode(message.data) for _, message in messages])
        except NONSENSE as error:
            raise RecordingError(f"{self.path}: {topic}: not a table: {error}") from error

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        """When each record of a topic was logged, on the log's own time line, of shape (n,).

        A record's own stamp may be another clock's: telemetry carries the autopilot's.
        """
        self._require(topic)
        times_ns = (message.log_time for _, message in self._messages({topic}))
        return np.fromiter(times_ns, dtype=np.int64)

    def frames(self) -> Iterator[StereoFrame]:
        """The stereo pairs, where the flight logged images."""
        self._require(Topic.RIGHT)
        left: Message | None = None
        for topic, message in self._messages({Topic.LEFT, Topic.RIGHT}):
            if topic == Topic.LEFT:
                left = message
            elif left is not None and left.publish_time == message.publish_time:
                yield StereoFrame(message.publish_time, self._eye(left), self._eye(message))

    def _eye(self, message: Message) -> NDArray[np.uint8]:
        data = msgspec.json.decode(message.data, type=CompressedImage).data
        eye = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if eye is None:
            raise RecordingError(f"{self.path}: image at {message.publish_time} ns is damaged")
        return np.asarray(eye, dtype=np.uint8)

    def _require(self, topic: str) -> None:
        if topic not in self._counts:
            known = ", ".join(sorted(self._counts)) or "none"
            raise RecordingError(f"{self.path}: no records on {topic}; it holds: {known}")

    def _read_metadata(self) -> FlightMetadata:
        """The header lies before all records, so a truncated log has it too."""
        try:
            with self.path.open("rb") as file:
                for record in StreamReader(file, emit_chunks=True).records:
                    if isinstance(record, Metadata) and record.name == METADATA_NAME:
                        fields = {k: msgspec.json.decode(v) for k, v in record.metadata.items()}
                        return msgspec.convert(fields, FlightMetadata)
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from error
        except DAMAGE as error:
            raise RecordingError(
                f"{self.path}: not a flight log (MCAP): {str(error) or 'cut off'}"
            ) from error
        raise RecordingError(f"{self.path}: an MCAP file, but not the log of a flight")

    def _count_records(self) -> Counter[str]:
        try:
            with self.path.open("rb") as file:
                summary = SeekingReader(file).get_summary()
            if summary is not None and summary.statistics is not None:
                counts = summary.statistics.channel_message_counts
                return Counter({c.topic: counts.get(c.id, 0) for c in summary.channels.values()})
        except DAMAGE:
            pass  # no index at the end: the log was cut off
        self.truncated = True
        return Counter(topic for topic, _ in self._messages(None))

    def _messages(self, topics: Collection[str] | None) -> Iterator[tuple[str, Message]]:
        try:
            with self.path.open("rb") as file:
                channel: Channel
                reader: McapReader = (NonSeekingReader if self.truncated else SeekingReader)(
                    file, validate_crcs=True
                )
                for _, channel, message in reader.iter_messages(topics, log_time_order=False):
                    yield channel.topic, message
        except DAMAGE as error:
            if not self.truncated:
                raise RecordingError(f"{self.path}: damaged: {error}") from error
