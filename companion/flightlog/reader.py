"""Reads a flight log, also one that was cut off."""

import gc
import logging
import struct
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import cv2
import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.records import Metadata
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from zstandard import ZstdError

from companion.flightlog.messages import (
    Index,
    Message,
    indexed_messages,
    read_index,
    streamed_messages,
)
from companion.flightlog.records import METADATA_NAME, CompressedImage, FlightMetadata, Topic
from companion.flightlog.schema import Columns, nan_restorer, table
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
        self.metadata = self._read_metadata()
        self._index = self._read_index()
        self.truncated = self._index is None
        self._counts = self._index.counts if self._index else self._counted()
        if self.truncated:
            log.warning("%s: cut off; read as far as it goes", path)

    def topics(self) -> dict[str, int]:
        """Number of records by topic."""
        return dict(self._counts)

    def read(self, topic: str, kind: type[T]) -> Iterator[T]:
        """The records of a topic in the order they were written."""
        self._require(topic)
        decode = _decoder(kind)
        for message in self._messages({topic}):
            try:
                yield decode(message.data)
            except NONSENSE as error:
                raise RecordingError(
                    f"{self.path}: {topic}: not a {kind.__name__}: {error}"
                ) from error

    def columns(self, topic: str) -> Columns:
        """A topic as a table: (n,) per field, (n, k) for vectors; null is NaN."""
        return self.tables(topic)[0]

    def tables(self, *topics: str) -> list[Columns]:
        """Several topics, each as ``columns``, in one pass over the file."""
        for topic in topics:
            self._require(topic)
        with _collector_paused():
            rows = self._decoded(self._messages(topics))
            return [self._table(topic, rows[topic]) for topic in topics]

    def nearest(self, topic: str, stamps_ns: NDArray[np.int64]) -> Columns:
        """The record of a topic whose stamp is nearest to each of these, as ``columns``."""
        self._require(topic)
        with _collector_paused():
            messages = list(self._messages({topic}))
            if not messages:
                raise RecordingError(f"{self.path}: no records on {topic}")
            known_ns = np.array([message.publish_time_ns for message in messages], dtype=np.int64)
            between_ns = (known_ns[1:] + known_ns[:-1]) // 2
            chosen, place = np.unique(np.searchsorted(between_ns, stamps_ns), return_inverse=True)
            rows = self._decoded(messages[number] for number in chosen)[topic]
            return {name: column[place] for name, column in self._table(topic, rows).items()}

    def _decoded(self, messages: Iterable[Message]) -> dict[str, list[Any]]:
        """By topic."""
        decode = msgspec.json.Decoder().decode
        rows: dict[str, list[Any]] = defaultdict(list)
        for message in messages:
            try:
                rows[message.topic].append(decode(message.data))
            except NONSENSE as error:
                raise self._no_table(message.topic, error) from error
        return rows

    def _table(self, topic: str, rows: list[Any]) -> Columns:
        try:
            return table(rows)
        except NONSENSE as error:
            raise self._no_table(topic, error) from error

    def _no_table(self, topic: str, error: Exception) -> RecordingError:
        return RecordingError(f"{self.path}: {topic}: not a table: {error}")

    def log_times_ns(self, topic: str) -> NDArray[np.int64]:
        """When each record of a topic was logged, on the log's own time line, of shape (n,).

        A record's own stamp may be another clock's: telemetry carries the autopilot's.
        """
        self._require(topic)
        times_ns = (message.log_time_ns for message in self._messages({topic}))
        return np.fromiter(times_ns, dtype=np.int64)

    def frames(self) -> Iterator[StereoFrame]:
        """The stereo pairs, where the flight logged images."""
        self._require(Topic.RIGHT)
        left: Message | None = None
        for message in self._messages({Topic.LEFT, Topic.RIGHT}):
            if message.topic == Topic.LEFT:
                left = message
            elif left is not None and left.publish_time_ns == message.publish_time_ns:
                yield StereoFrame(message.publish_time_ns, self._eye(left), self._eye(message))

    def _eye(self, message: Message) -> NDArray[np.uint8]:
        data = msgspec.json.decode(message.data, type=CompressedImage).data
        eye = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if eye is None:
            raise RecordingError(f"{self.path}: image at {message.publish_time_ns} ns is damaged")
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

    def _counted(self) -> Counter[str]:
        return Counter(message.topic for message in self._messages(None))

    def _read_index(self) -> Index | None:
        """None for a log that was cut off."""
        try:
            with self.path.open("rb") as file:
                return read_index(file)
        except DAMAGE:
            return None

    def _messages(self, topics: Collection[str] | None) -> Iterator[Message]:
        try:
            with self.path.open("rb") as file:
                if self._index is None or topics is None:
                    yield from streamed_messages(file, topics)
                else:
                    yield from indexed_messages(file, self._index, topics)
        except DAMAGE as error:
            if not self.truncated:
                raise RecordingError(f"{self.path}: damaged: {error}") from error


def _decoder(kind: type[T]) -> Callable[[bytes], T]:
    """Of JSON, null where the type says number included, which msgspec itself refuses."""
    restore = nan_restorer(kind)
    decode_known = msgspec.json.Decoder(kind).decode

    def decode(data: bytes) -> T:
        try:
            return decode_known(data)
        except msgspec.ValidationError:
            return msgspec.convert(restore(msgspec.json.decode(data)), kind)

    return decode


@contextmanager
def _collector_paused() -> Iterator[None]:
    """Decoding makes nothing but new objects, among which the collector would search for garbage
    again and again."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
