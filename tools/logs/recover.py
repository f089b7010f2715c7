"""Makes a whole, indexed MCAP file of one that was cut off or damaged."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from companion.flightlog.writer import CHUNK_BYTES
from companion.kernel.errors import RecordingError
from tools.logs.scan import Damage, End, Part, scan

RECOVERED_SUFFIX = ".recovered.mcap"


class Recovery(NamedTuple):
    """What came of it. ``lost_bytes``: of the damaged chunks and behind the last whole record."""

    records: int
    orphans: int
    """Readable messages dropped because the damage took what says which topic they are of."""
    damaged_parts: int
    lost_bytes: int
    was_whole: bool


def recover(path: Path, out: Path) -> Recovery:
    """Copies every readable record to ``out``, in order. Raises RecordingError."""
    if out.exists() and out.samefile(path):
        raise RecordingError(f"{out}: would overwrite the log to recover")
    parts = scan(path)
    header = next(parts)
    if not isinstance(header, Header):
        raise RecordingError(f"{path}: cut off before its first record: nothing to recover")
    known = [part for part in scan(path) if isinstance(part, Schema | Channel)]
    partial = out.with_name(out.name + ".part")
    try:
        with partial.open("wb") as file:
            copier = _Copier(file, header, known)
            for part in parts:
                copier.add(part)
            recovery = copier.finish()
        partial.replace(out)
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written: {error.strerror}") from error
    finally:
        partial.unlink(missing_ok=True)
    return recovery


class _Copier:
    def __init__(self, file: BinaryIO, header: Header, known: Sequence[Schema | Channel]) -> None:
        """``known``: also those that stand only at the file's end, behind a damaged chunk."""
        self._mcap: Any = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._mcap.start(profile=header.profile, library=header.library)
        self._schemas = {part.id: part for part in known if isinstance(part, Schema)}
        self._channels = {part.id: part for part in known if isinstance(part, Channel)}
        self._new_schema_ids = {0: 0}  # 0 says: a channel without a schema
        self._new_channel_ids: dict[int, int] = {}
        self._records = self._orphans = self._damaged = self._lost_bytes = 0
        self._whole = False

    def add(self, part: Part) -> None:
        match part:
            case Message():
                self._add_message(part)
            case Metadata(name=name, metadata=fields):
                self._mcap.add_metadata(name, fields)
            case Attachment():
                self._mcap.add_attachment(
                    part.create_time, part.log_time, part.name, part.media_type, part.data
                )
            case Damage(length=length):
                self._damaged += 1
                self._lost_bytes += length
            case End(whole=whole, unread_bytes=unread_bytes):
                self._whole = whole
                self._lost_bytes += unread_bytes

    def _add_message(self, message: Message) -> None:
        if message.channel_id not in self._channels:
            self._orphans += 1
            return
        if message.channel_id not in self._new_channel_ids:
            self._register(self._channels[message.channel_id])
        self._mcap.add_message(
            self._new_channel_ids[message.channel_id],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )
        self._records += 1

    def _register(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        if schema is not None and schema.id not in self._new_schema_ids:
            new_id = self._mcap.register_schema(schema.name, schema.encoding, schema.data)
            self._new_schema_ids[schema.id] = new_id
        self._new_channel_ids[channel.id] = self._mcap.register_channel(
            channel.topic,
            channel.message_encoding,
            self._new_schema_ids.get(channel.schema_id, 0),
            channel.metadata,
        )

    def finish(self) -> Recovery:
        self._mcap.finish()
        return Recovery(self._records, self._orphans, self._damaged, self._lost_bytes, self._whole)
