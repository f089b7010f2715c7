"""Writes a flight log that stays readable whatever ends the flight."""

import logging
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import cv2
import msgspec
import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from companion.flightlog.files import BackgroundFile, PatientFile
from companion.flightlog.records import (
    METADATA_NAME,
    VIEWS,
    WELL_KNOWN,
    CompressedImage,
    FlightMetadata,
    Record,
    Topic,
    View,
    split_time,
)
from companion.flightlog.schema import encodable, json_schema
from companion.kernel.errors import RecordingError
from companion.kernel.messages import Event, StereoFrame

CHUNK_BYTES = 256 * 1024  # compressed in one go: about a millisecond
FLUSH_INTERVAL_NS = 500_000_000  # a killed process may lose this, and what is on its way
IMAGES_ROOM_BYTES = 32 * 1024 * 1024
RECORDS_ROOM_BYTES = 48 * 1024 * 1024
"""Images, and later records, are left out while more than this waits for a slow disk."""
PNG_FASTEST = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)

log = logging.getLogger(__name__)


class FlightLogWriter:
    """The log of one flight; opened by the constructor, closed by ``close`` or ``with``.

    The same calls give the same bytes. A thread hands chunks to the operating system at least
    twice per second of log time, so a killed process loses no more than the last second. When the
    file cannot be written any more, the next call raises RecordingError; later records are
    dropped, so that whoever caught it can still land. A disk that is too slow costs images first
    and then records, which is said in an event as soon as there is room again; a ``patient`` log
    waits for it instead.
    """

    def __init__(
        self,
        path: Path,
        metadata: FlightMetadata,
        images: Literal["off", "stereo"] = "off",
        patient: bool = False,
    ) -> None:
        """Raises RecordingError when the file cannot be made."""
        self.path = path
        self._images = images
        self._encoder = msgspec.json.Encoder(enc_hook=encodable)
        self._channels: dict[str, tuple[int, type, View | None]] = {}
        self._schemas: dict[type, int] = {}
        self._view_due_ns: dict[str, int] = {}
        self._pairs_lost = self._records_lost = 0
        self._patient = patient
        self._file: BackgroundFile | PatientFile | None = None
        self._mcap: Any  # its finish and flush carry no types
        try:
            self._file = PatientFile(path) if patient else BackgroundFile(path)
            stream: Any = self._file  # of a stream, no more is needed than it has
            self._mcap = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
            self._mcap.start(profile="", library="mono-companion")
            self._mcap.add_metadata(METADATA_NAME, _json_fields(metadata))
            self._flush(log_time_ns=-FLUSH_INTERVAL_NS)
            self._file.drain()
        except OSError as error:
            self._give_up(error)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except RecordingError as error:
            if exc is None:
                raise
            log.error("%s", error)  # the flight's own error says more

    def write(self, topic: str, record: Record, log_time_ns: int | None = None) -> None:
        """Appends a msgspec Struct; its type must be the same for all of a topic.

        ``log_time_ns`` places a record stamped by another clock (the autopilot's) on the log's
        time line; without it the record's own stamp does.
        """
        if self._file is None:
            return
        if not self._has_room(RECORDS_ROOM_BYTES):
            self._records_lost += 1
            return
        if log_time_ns is None:
            log_time_ns = record.stamp_ns
        self._tell_losses(log_time_ns)
        try:
            channel_id, kind, view = self._channels.get(topic) or self._open(topic, type(record))
            if type(record) is not kind:
                raise TypeError(f"{topic} holds {kind.__name__}, not {type(record).__name__}")
            self._append(channel_id, record, log_time_ns, record.stamp_ns)
            if view is not None and log_time_ns >= self._view_due_ns.get(topic, 0):
                self._view_due_ns[topic] = log_time_ns + view.period_ns
                channel_id = self._channels[topic + view.suffix][0]
                self._append(channel_id, view.convert(record), log_time_ns, record.stamp_ns)
        except OSError as error:
            self._give_up(error)

    def write_frame(self, frame: StereoFrame, log_time_ns: int | None = None) -> None:
        """Appends both eyes, lossless, where the plan asks for images; else does nothing."""
        if self._images == "off" or self._file is None:
            return
        if not self._has_room(IMAGES_ROOM_BYTES):
            self._pairs_lost += 1
            return
        if log_time_ns is None:
            log_time_ns = frame.stamp_ns
        try:
            for topic, eye in ((Topic.LEFT, frame.left), (Topic.RIGHT, frame.right)):
                if not eye.size:
                    continue
                channel = self._channels.get(topic) or self._open(topic, CompressedImage)
                image = _compress(eye, frame.stamp_ns, topic.rpartition("/")[2])
                self._append(channel[0], image, log_time_ns, frame.stamp_ns)
        except OSError as error:
            self._give_up(error)

    def close(self) -> None:
        """Ends the file with its index; a second call does nothing. Raises RecordingError."""
        if self._file is None:
            return
        try:
            self._mcap.finish()
            self._file.close()
            self._file = None
        except OSError as error:
            self._give_up(error)
        if self._pairs_lost or self._records_lost:
            log.warning("%s: %s", self.path, self._losses())

    def _has_room(self, limit_bytes: int) -> bool:
        assert self._file is not None
        return self._patient or self._file.waiting_bytes <= limit_bytes

    def _losses(self) -> str:
        return (
            f"the disk is too slow: {self._pairs_lost} stereo pairs and {self._records_lost} "
            "records were left out"
        )

    def _tell_losses(self, log_time_ns: int) -> None:
        """In the log itself, once there is room for what was too much."""
        if (self._pairs_lost or self._records_lost) and self._has_room(IMAGES_ROOM_BYTES // 2):
            text = self._losses()
            self._pairs_lost = self._records_lost = 0
            log.warning("%s: %s", self.path, text)
            self.write(Topic.EVENT, Event(stamp_ns=log_time_ns, severity="warning", text=text))

    def _append(
        self, channel_id: int, record: object, log_time_ns: int, publish_time_ns: int
    ) -> None:
        data = self._encoder.encode(record)
        self._mcap.add_message(channel_id, log_time_ns, data, publish_time_ns)
        if log_time_ns - self._flushed_ns >= FLUSH_INTERVAL_NS:
            self._flush(log_time_ns)

    def _flush(self, log_time_ns: int) -> None:
        self._mcap.flush()
        self._flushed_ns = log_time_ns

    def _open(self, topic: str, kind: type[Any]) -> tuple[int, type, View | None]:
        """Declares a topic on its first record, and that of its view."""
        view = VIEWS.get(kind)
        if view is not None:
            self._open(topic + view.suffix, view.kind)
        if kind not in self._schemas:
            name = WELL_KNOWN.get(kind, kind.__name__)
            text = msgspec.json.encode(json_schema(kind))
            self._schemas[kind] = self._mcap.register_schema(name, "jsonschema", text)
        channel_id = self._mcap.register_channel(str(topic), "json", self._schemas[kind])
        self._channels[topic] = (channel_id, kind, view)
        return self._channels[topic]

    def _give_up(self, error: OSError) -> None:
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError:
                log.debug("%s: its last bytes are lost", self.path)
        raise RecordingError(f"{self.path}: cannot be written: {error.strerror}") from error


def _compress(eye: NDArray[np.uint8], stamp_ns: int, frame_id: str) -> CompressedImage:
    data = cv2.imencode(".png", eye, PNG_FASTEST)[1].tobytes()
    return CompressedImage(split_time(stamp_ns), frame_id, data, "png")


def _json_fields(value: msgspec.Struct) -> dict[str, str]:
    return {
        name: msgspec.json.encode(getattr(value, name)).decode() for name in value.__struct_fields__
    }
