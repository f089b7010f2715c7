"""Cut off and damaged logs: what is said of them, and what is saved of them."""

import struct
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from companion.flightlog import FlightLog
from companion.kernel.errors import RecordingError
from tools.logs import __main__ as logs
from tools.logs import open_log
from tools.logs.recover import recover


@pytest.fixture(scope="module")
def whole(tmp_path_factory, invented):
    path = tmp_path_factory.mktemp("whole") / "flight.mcap"
    return invented.flight(path, invented.Motion(seed=1, duration_s=12.0))


@pytest.fixture(scope="module")
def chunks(whole):
    """(end offset, number of messages) of each chunk, by the index at the file's end."""
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    ends = [chunk.chunk_start_offset + chunk.chunk_length for chunk in summary.chunk_indexes]
    with whole.open("rb") as file:
        records = [r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)]
    assert len(records) == len(ends)
    counts = [sum(isinstance(r, Message) for r in breakup_chunk(chunk)) for chunk in records]
    return list(zip(ends, counts, strict=True))


def messages(path):
    with path.open("rb") as file:
        return [
            (channel.topic, schema.name, message.log_time, message.publish_time, message.data)
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            )
        ]


@settings(max_examples=40)
@given(data=st.data())
def test_cut_anywhere_no_whole_chunk_is_lost(whole, chunks, tmp_path_factory, data):
    content = whole.read_bytes()
    length = data.draw(st.integers(0, len(content) - 1))
    folder = tmp_path_factory.mktemp("cut")
    cut, out = folder / "flight.mcap", folder / "out.mcap"
    cut.write_bytes(content[:length])
    readable = sum(count for end, count in chunks if end <= length)
    try:
        found = recover(cut, out)
    except RecordingError:
        assert readable == 0
        assert not list(folder.glob("out*"))
        return
    assert found.records == readable
    assert not found.was_whole
    assert messages(out) == messages(whole)[:readable]


@settings(max_examples=40)
@given(data=st.data())
def test_damaged_anywhere_it_never_crashes_nor_invents(whole, tmp_path_factory, data):
    content = bytearray(whole.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    noise = data.draw(st.binary(min_size=1, max_size=40))
    content[at : at + len(noise)] = noise
    folder = tmp_path_factory.mktemp("damaged")
    path = folder / "flight.mcap"
    path.write_bytes(content)
    out = folder / "out.mcap"
    with suppress(RecordingError):
        recover(path, out)
    with suppress(RecordingError):
        open_log(path).examine()
    written = {message[4] for message in messages(whole)}
    assert not out.exists() or {message[4] for message in messages(out)} <= written


def test_a_damaged_chunk_costs_only_itself(whole, chunks, tmp_path):
    content = bytearray(whole.read_bytes())
    end, _ = chunks[4]
    content[end - 40 : end - 32] = bytes(8)
    path = tmp_path / "flight.mcap"
    path.write_bytes(content)
    found = recover(path, tmp_path / "out.mcap")
    lost = sum(count for _, count in chunks) - found.records
    assert (found.damaged_parts, lost, found.was_whole) == (1, chunks[4][1], True)


def test_the_first_chunks_channels_are_known_from_the_end(whole, chunks, tmp_path):
    """The first chunk declares the topics; the index at the file's end repeats them."""
    content = bytearray(whole.read_bytes())
    end, _ = chunks[0]
    content[end - 40 : end - 32] = bytes(8)
    path = tmp_path / "flight.mcap"
    path.write_bytes(content)
    found = recover(path, tmp_path / "out.mcap")
    assert found.orphans == 0
    assert found.records == sum(count for _, count in chunks[1:])
    assert FlightLog(tmp_path / "out.mcap").topics().keys() == FlightLog(whole).topics().keys()


def test_a_recovered_flight_is_a_sound_log(whole, tmp_path, capsys):
    cut = tmp_path / "flight.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert logs.main(["verify", str(cut)]) == 1
    assert "PROBLEM: cut off" in capsys.readouterr().out
    assert logs.main(["recover", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "flight.mcap was cut off" in text
    out = tmp_path / "flight.recovered.mcap"
    assert logs.main(["verify", str(out)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"{out}: sound, ")
    assert not FlightLog(out).truncated
    assert FlightLog(out).metadata == FlightLog(whole).metadata


def test_a_whole_log_recovers_to_the_same_records(whole, tmp_path):
    found = recover(whole, tmp_path / "out.mcap")
    assert (found.was_whole, found.lost_bytes) == (True, 0)
    assert messages(tmp_path / "out.mcap") == messages(whole)


def test_a_log_is_not_recovered_onto_itself(whole, capsys):
    before = whole.read_bytes()
    assert logs.main(["recover", str(whole), "--out", str(whole)]) == 1
    assert "would overwrite" in capsys.readouterr().err
    assert whole.read_bytes() == before


def test_what_is_no_mcap_is_one_line(tmp_path, capsys):
    (tmp_path / "flight.mcap").write_bytes(b"hello")
    assert logs.main(["recover", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"logs: {tmp_path / 'flight.mcap'}: not an MCAP file\n"


def problems(path):
    return [finding.text for finding in open_log(path).examine().findings if finding.problem]


def test_a_whole_log_is_sound(whole):
    assert problems(whole) == []


def test_frames_that_stay_away_are_found(tmp_path, invented):
    motion = invented.Motion(seed=1, duration_s=12.0)
    path = invented.flight(tmp_path / "a.mcap", motion, skip=range(40, 50))
    found = problems(path)
    assert len(found) == 3  # percept, decision, setpoint
    assert "1 gaps longer than 0.5 s, the longest 1.10 s at 8.90 s" in found[0]


def test_a_lost_chunk_is_found(whole, chunks, tmp_path):
    content = bytearray(whole.read_bytes())
    end, _ = chunks[4]
    content[end - 40 : end - 32] = bytes(8)
    path = tmp_path / "flight.mcap"
    path.write_bytes(content)
    found = problems(path)
    assert found[0].startswith("damaged at byte ")
    assert any("records read, " in text for text in found)


def test_a_clock_that_runs_backwards_is_found(tmp_path, invented):
    motion = invented.Motion(seed=1, duration_s=12.0)
    path = invented.tlog(tmp_path / "a.tlog", motion)
    data = bytearray(path.read_bytes())
    at = data.index(b"\xfd", 2000) - 8
    data[at : at + 8] = struct.pack(">Q", 1_000_000)
    path.write_bytes(data)
    assert any("time steps back 1 times" in text for text in problems(path))


def test_a_frame_with_a_wrong_checksum_is_found(tmp_path, invented):
    path = invented.tlog(tmp_path / "a.tlog", invented.Motion(seed=1, duration_s=12.0))
    data = bytearray(path.read_bytes())
    data[data.index(b"\xfd", 2000) + 15] ^= 0xFF
    path.write_bytes(data)
    assert problems(path) == ["1 frames with a wrong checksum"]


def test_px4s_dropouts_are_told_but_no_problem(tmp_path, invented):
    motion = invented.Motion(seed=1, duration_s=12.0)
    path = invented.ulog(tmp_path / "a.ulg", motion, dropout_ms=250)
    (finding,) = open_log(path).examine().findings
    assert finding == (
        False,
        "1 dropouts while logging, 0.25 s in all, the longest 0.25 s",
    )
