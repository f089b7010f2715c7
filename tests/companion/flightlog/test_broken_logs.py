"""Flight logs that end early, or are damaged, or are none: whatever is whole is read."""

import resource
import signal
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from companion.flightlog import FlightLog, FlightLogWriter, Topic
from companion.kernel.errors import RecordingError
from companion.kernel.messages import Percept, Telemetry

KILLED = """
import os, signal, sys
from pathlib import Path
from companion.flightlog import FlightLogWriter, FlightMetadata
from companion.kernel.messages import Telemetry
metadata = FlightMetadata(plan={}, seed=1, version="0")
log = FlightLogWriter(Path(sys.argv[1]), metadata, patient=True)
for i in range(100):
    log.write("/telemetry", Telemetry(stamp_ns=i * 100_000_000))
os.kill(os.getpid(), signal.SIGKILL)
"""


@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_cut_log_is_read_as_far_as_it_goes(whole_log, share):
    data = whole_log.read_bytes()
    header = data.index(b"calibration") + 400
    cut = whole_log.with_name("cut.mcap")
    cut.write_bytes(data[: header + round(share * (len(data) - header - 1))])
    log = FlightLog(cut)
    assert log.truncated
    whole = list(FlightLog(whole_log).read(Topic.PERCEPT, Percept))
    if Topic.PERCEPT in log.topics():
        read = list(log.read(Topic.PERCEPT, Percept))
        assert len(read) == log.topics()[Topic.PERCEPT]
        assert repr(read) == repr(whole[: len(read)])  # NaN equals NaN


def test_a_killed_process_loses_at_most_a_second(tmp_path):
    path = tmp_path / "flight.mcap"
    killed = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert killed.returncode == -signal.SIGKILL
    log = FlightLog(path)
    assert log.truncated
    stamps_ns = log.columns("/telemetry")["stamp_ns"]
    assert stamps_ns[-1] >= 99 * 100_000_000 - 1_000_000_000


def write_all(log, items):
    for topic, record in items:
        log.write(topic, record)


def test_a_full_disk_is_one_error_and_leaves_a_log(tmp_path, metadata, records):
    path = tmp_path / "flight.mcap"
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    log = FlightLogWriter(path, metadata, patient=True)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, unlimited[1]))
    try:
        with pytest.raises(RecordingError, match=r"flight.mcap: cannot be written: ") as caught:
            write_all(log, records(3000))
        assert "\n" not in str(caught.value)
        log.write(Topic.TELEMETRY, Telemetry(stamp_ns=1))  # landing goes on
        log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    assert FlightLog(path).truncated
    assert FlightLog(path).topics()[Topic.TELEMETRY] > 50


def test_closing_twice_is_safe(tmp_path, metadata):
    with FlightLogWriter(tmp_path / "flight.mcap", metadata) as log:
        log.close()
    assert not FlightLog(tmp_path / "flight.mcap").truncated


def test_the_folder_must_exist(tmp_path, metadata):
    with pytest.raises(RecordingError, match="cannot be written: No such file"):
        FlightLogWriter(tmp_path / "none" / "flight.mcap", metadata)


def foreign_mcap(path):
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda path: None, "cannot be read: No such file"),
        (lambda path: path.mkdir(), "cannot be read: Is a directory"),
        (lambda path: path.write_bytes(b""), "not a flight log"),
        (lambda path: path.write_text("hello, this is text"), "not a flight log"),
        (lambda path: path.write_bytes(bytes(10_000)), "not a flight log"),
        (foreign_mcap, "not the log of a flight"),
    ],
)
def test_what_is_no_log_is_one_clear_error(tmp_path, make, text):
    path = tmp_path / "some.mcap"
    make(path)
    with pytest.raises(RecordingError, match=text) as caught:
        FlightLog(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_damage_inside_a_whole_log_is_not_hidden(tmp_path, whole_log):
    with whole_log.open("rb") as file:
        chunk = make_reader(file).get_summary().chunk_indexes[2]
    data = bytearray(whole_log.read_bytes())
    end = chunk.chunk_start_offset + chunk.chunk_length
    data[end - 40 : end - 32] = bytes(8)
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="damaged"):
        list(FlightLog(path).read(Topic.PERCEPT, Percept))
