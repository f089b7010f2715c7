"""A disk that takes its time: nobody waits for it, images go first, and the log says so."""

import errno
import os
import threading

import numpy as np
import pytest

from companion.flightlog import FlightLog, FlightLogWriter, FlightMetadata, Topic, writer
from companion.flightlog.files import BackgroundFile
from companion.kernel.errors import RecordingError
from companion.kernel.messages import Event, StereoFrame, Telemetry

META = FlightMetadata(plan={}, seed=1, version="0")
STEP_NS = 100_000_000


def noisy_pair(number):
    """Nothing to compress: 30 kB in the log."""
    left, right = np.random.default_rng(number).integers(0, 256, (2, 96, 128), dtype=np.uint8)
    return StereoFrame(number * STEP_NS, left, right)


class SlowDisk:
    """A pipe that takes 64 kB and no more until it is read."""

    def __init__(self, path):
        os.mkfifo(path)
        self._end = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        self.path = path

    def read_on(self, into):
        """Reads in a thread of its own until the writer closes; join it."""
        os.set_blocking(self._end, True)

        def read():
            with open(into, "wb") as file, os.fdopen(self._end, "rb") as end:
                while data := end.read(65536):
                    file.write(data)

        thread = threading.Thread(target=read)
        thread.start()
        return thread

    def break_off(self):
        os.close(self._end)


@pytest.fixture
def disk(tmp_path):
    return SlowDisk(tmp_path / "slow.mcap")


def telemetry(number):
    return Telemetry(stamp_ns=number * STEP_NS)


def test_images_are_left_out_first_and_the_log_says_how_many(disk, tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "IMAGES_ROOM_BYTES", 500_000)
    log = FlightLogWriter(disk.path, META, images="stereo")
    for number in range(200):  # 5 MB of images
        log.write_frame(noisy_pair(number))
        log.write(Topic.TELEMETRY, telemetry(number))
    reading = disk.read_on(tmp_path / "flight.mcap")
    log._file.drain()
    log.write(Topic.TELEMETRY, telemetry(200))
    log.write_frame(noisy_pair(200))
    log.close()
    reading.join()
    read = FlightLog(tmp_path / "flight.mcap")
    assert not read.truncated
    assert read.topics()[Topic.TELEMETRY] == 201
    kept = read.topics()[Topic.LEFT]
    assert 10 < kept < 100
    (event,) = read.read(Topic.EVENT, Event)
    lost = f"{201 - kept} stereo pairs and 0 records were left out"
    assert (event.severity, event.text) == ("warning", f"the disk is too slow: {lost}")


def test_records_are_left_out_when_there_is_no_room_at_all(disk, tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "RECORDS_ROOM_BYTES", 100_000)
    rng = np.random.default_rng(1)
    log = FlightLogWriter(disk.path, META)
    for number in range(20_000):
        log.write(Topic.TELEMETRY, Telemetry(stamp_ns=number * STEP_NS, yaw_rad=rng.random()))
    reading = disk.read_on(tmp_path / "flight.mcap")
    log._file.drain()
    log.write(Topic.TELEMETRY, telemetry(20_000))
    log.close()
    reading.join()
    read = FlightLog(tmp_path / "flight.mcap")
    kept = read.topics()[Topic.TELEMETRY]
    assert 100 < kept < 20_000
    (event,) = read.read(Topic.EVENT, Event)
    assert f"0 stereo pairs and {20_001 - kept} records" in event.text


def test_a_patient_log_leaves_nothing_out(disk, tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "IMAGES_ROOM_BYTES", 1)
    with FlightLogWriter(disk.path, META, images="stereo", patient=True) as log:
        reading = disk.read_on(
            tmp_path / "flight.mcap"
        )  # a pipe that nobody writes to is at its end
        for number in range(50):
            log.write_frame(noisy_pair(number))
    reading.join()
    assert FlightLog(tmp_path / "flight.mcap").topics() == {Topic.LEFT: 50, Topic.RIGHT: 50}


def test_a_disk_that_breaks_is_told_at_the_next_record(disk):
    log = FlightLogWriter(disk.path, META)
    disk.break_off()

    def write_on():
        for number in range(100_000):
            log.write(Topic.TELEMETRY, telemetry(number))

    with pytest.raises(RecordingError, match=r"slow\.mcap: cannot be written: Broken pipe"):
        write_on()
    log.close()


def test_a_disk_that_never_answers_is_given_up(disk, monkeypatch):
    monkeypatch.setattr("companion.flightlog.files.ANSWER_LIMIT_S", 0.05)
    file = BackgroundFile(disk.path)
    file.write(bytes(200_000))
    with pytest.raises(OSError, match="the disk does not answer") as caught:
        file.close()
    assert caught.value.errno == errno.ETIMEDOUT
    disk.break_off()  # ends the thread
    file._thread.join()
