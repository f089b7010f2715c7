"""The messages of an MCAP file, read chunk by chunk.

The mcap library's readers make an object of every record of every topic, field by field, which is
most of the time that reading a flight takes. Here the library reads and checks the chunks, and a
message is a slice of one.
"""

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk
from mcap.records import Message as MessageRecord
from mcap.stream_reader import StreamReader, get_chunk_data_stream

_HEAD = struct.Struct("<BQ")
"""Of every record: its kind, and the length of what follows."""
_MESSAGE = struct.Struct("<HIQQ")
"""Of a message: channel, sequence number, log time, publish time; the data follows."""


class Message(NamedTuple):
    topic: str
    log_time_ns: int
    publish_time_ns: int
    data: bytes


class Index(NamedTuple):
    """What a file that was ended properly says about itself."""

    topics: dict[int, str]
    """By channel."""
    counts: Counter[str]
    """Messages by topic."""
    chunks: list[tuple[int, frozenset[int]]]
    """Where each chunk begins, and the channels that it has messages of; none: not known."""


def read_index(file: BinaryIO) -> Index | None:
    """None where the file was ended without. Raises what the mcap library does for damage."""
    summary = SeekingReader(file).get_summary()
    if summary is None or summary.statistics is None:
        return None
    topics = {channel.id: channel.topic for channel in summary.channels.values()}
    counts = summary.statistics.channel_message_counts
    chunks = [
        (chunk.chunk_start_offset, frozenset(chunk.message_index_offsets))
        for chunk in summary.chunk_indexes
    ]
    return Index(topics, Counter({topics[i]: counts.get(i, 0) for i in topics}), chunks)


def indexed_messages(file: BinaryIO, index: Index, topics: Collection[str]) -> Iterator[Message]:
    """In the order of the file; only chunks that hold these topics are read."""
    if not index.chunks:
        file.seek(0)
        yield from streamed_messages(file, topics)
        return
    wanted = {i: topic for i, topic in index.topics.items() if topic in topics}
    for offset, channels in index.chunks:
        if not channels or not channels.isdisjoint(wanted):
            file.seek(offset + _HEAD.size)
            chunk = Chunk.read(ReadDataStream(file))
            yield from _messages_in(_content(chunk), wanted)


def streamed_messages(file: BinaryIO, topics: Collection[str] | None) -> Iterator[Message]:
    """From the front, without the help of an index; all topics where none are named."""
    wanted: dict[int, str] = {}

    def declare(channel: Channel) -> None:
        if topics is None or channel.topic in topics:
            wanted[channel.id] = channel.topic

    for record in StreamReader(file, emit_chunks=True).records:
        match record:
            case Channel():
                declare(record)
            case Chunk():
                content = _content(record)
                for channel in _channels_in(content):
                    declare(channel)
                yield from _messages_in(content, wanted)
            case MessageRecord(channel_id=i) if i in wanted:  # a file without chunks
                yield Message(wanted[i], record.log_time, record.publish_time, record.data)


def _content(chunk: Chunk) -> bytes:
    """Raises CRCValidationError, a ValueError."""
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def _messages_in(content: bytes, wanted: dict[int, str]) -> Iterator[Message]:
    for kind, begin, end in _records_in(content):
        if kind == Opcode.MESSAGE:
            channel_id, _, log_time_ns, publish_time_ns = _MESSAGE.unpack_from(content, begin)
            topic = wanted.get(channel_id)
            if topic is not None:
                data = content[begin + _MESSAGE.size : end]
                yield Message(topic, log_time_ns, publish_time_ns, data)


def _channels_in(content: bytes) -> Iterator[Channel]:
    for kind, begin, end in _records_in(content):
        if kind == Opcode.CHANNEL:
            yield Channel.read(ReadDataStream(BytesIO(content[begin:end])))


def _records_in(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Kind, begin and end of each. Raises EndOfFile where one would reach beyond the chunk."""
    position = 0
    while position < len(content):
        kind, length = _HEAD.unpack_from(content, position)
        begin = position + _HEAD.size
        position = begin + length
        if position > len(content):
            raise EndOfFile("a record reaches beyond its chunk")
        yield kind, begin, position
