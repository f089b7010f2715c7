"""Walks an MCAP file record by record, past damage, so far as its bytes go.

The mcap library's own readers stop at the first record that makes no sense. Here a chunk is taken
when it is whole and its CRC is right, and skipped when not.
"""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import Chunk, Footer, McapRecord
from mcap.stream_reader import StreamReader, breakup_chunk

from companion.flightlog.reader import DAMAGE
from companion.kernel.errors import RecordingError

MCAP_MAGIC = b"\x89MCAP0\r\n"
_FRAME_BYTES = 9  # opcode, then length of the content
_CHUNK_LIMIT_BYTES = 1 << 30
"""A chunk that says to be larger is damaged; nobody shall be asked for the memory."""


class Damage(NamedTuple):
    """Bytes that hold no readable record."""

    offset: int
    length: int
    reason: str


class End(NamedTuple):
    """Comes last. ``whole``: the file ends as a finished one does."""

    whole: bool
    unread_bytes: int


Part = McapRecord | Damage | End
"""A record (those of a chunk one by one, behind their chunk), a damaged place, or the end."""


def scan(path: Path) -> Iterator[Part]:
    """Raises RecordingError for what cannot be opened, or is no MCAP file at all."""
    try:
        with path.open("rb") as file:
            if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise RecordingError(f"{path}: not an MCAP file")
            yield from _walk(file, path.stat().st_size)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error


def _walk(file: BinaryIO, size: int) -> Iterator[Part]:
    ended = False
    while not ended:
        offset = file.tell()
        head = file.read(_FRAME_BYTES)
        length = int.from_bytes(head[1:], "little")
        if len(head) < _FRAME_BYTES or offset + _FRAME_BYTES + length > size:
            yield End(False, size - offset)
            return
        frame = head + file.read(length)
        for part in _parts(frame, offset):
            yield part
            ended = ended or isinstance(part, Footer)
    tail = file.read()
    yield End(tail == MCAP_MAGIC, 0 if tail == MCAP_MAGIC else len(tail))


def _parts(frame: bytes, offset: int) -> list[Part]:
    try:
        record = next(StreamReader(BytesIO(frame), skip_magic=True, emit_chunks=True).records)
        return [record, *_content(record)] if isinstance(record, Chunk) else [record]
    except (*DAMAGE, StopIteration) as error:
        return [Damage(offset, len(frame), str(error) or type(error).__name__)]


def _content(chunk: Chunk) -> list[McapRecord]:
    if chunk.uncompressed_size > _CHUNK_LIMIT_BYTES:
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes")
    return breakup_chunk(chunk, validate_crc=True)
