"""Logs as other programs would write them: compressed, chunked and indexed in any way."""

import msgspec
import pytest
from mcap.writer import CompressionType, IndexType, Writer

from companion.flightlog import FlightLog
from companion.kernel.errors import RecordingError

WRITERS = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "without chunks": {"use_chunking": False},
    "without an index": {"index_types": IndexType.NONE},
    "without an index of messages": {"index_types": IndexType.CHUNK},
}


def write_as_others_do(path, metadata, **options):
    """Two topics, a chunk every few records."""
    header = {
        name: msgspec.json.encode(getattr(metadata, name)).decode()
        for name in metadata.__struct_fields__
    }
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=500, **options)
        writer.start()
        writer.add_metadata("flight", header)
        channels = [writer.register_channel(topic, "json", 0) for topic in ("/a", "/b")]
        for number in range(50):
            record = msgspec.json.encode({"stamp_ns": number, "text": "some words " * 3})
            writer.add_message(channels[number % 2], number + 1000, record, number)
        writer.finish()


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("share", [1.0, 0.6])
def test_other_writers_files_are_read_alike(tmp_path, metadata, kind, share):
    path = tmp_path / "flight.mcap"
    write_as_others_do(path, metadata, **WRITERS[kind])
    data = path.read_bytes()
    path.write_bytes(data[: round(share * len(data))])
    log = FlightLog(path)
    stamps_ns = log.columns("/b")["stamp_ns"].tolist()
    assert stamps_ns == list(range(1, 50, 2))[: len(stamps_ns)]
    assert len(stamps_ns) == log.topics()["/b"]
    assert (log.log_times_ns("/b") - stamps_ns == 1000).all()
    assert (len(stamps_ns) == 25) == (share == 1.0)
    assert len(stamps_ns) > 5


def test_a_record_that_reaches_beyond_its_chunk_is_damage(tmp_path, metadata):
    path = tmp_path / "flight.mcap"
    write_as_others_do(path, metadata, compression=CompressionType.NONE, enable_crcs=False)
    data = bytearray(path.read_bytes())
    length_at = data.index(b'{"stamp_ns":20,') - 22 - 8
    assert data[length_at - 1] == 0x05  # a message
    data[length_at : length_at + 8] = (1 << 40).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="damaged: a record reaches beyond its chunk"):
        FlightLog(path).columns("/a")
