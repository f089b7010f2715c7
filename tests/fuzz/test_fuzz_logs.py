"""Recordings of cameras and logs of flights, of every kind that is read."""

import json
import shutil
import struct
from pathlib import Path

import msgspec
import pytest
from mcap.writer import Writer
from pymavlink.dialects.v20 import common as mavlink

from companion.camera.asl import AslRecording
from companion.flightlog import FlightLog, FlightLogWriter, FlightMetadata, Topic
from companion.flightlog.records import METADATA_NAME
from companion.kernel.messages import Percept, StereoFrame, Telemetry
from sitl.mavlink.framing import Source, encode
from tools.logs.opening import open_log
from tools.logs.recover import recover

RECORDING = Path(__file__).parents[1] / "data" / "room1"


@pytest.mark.parametrize("name", ["cam0/sensor.yaml", "cam1/data.csv", "cam1/data/*.png"])
def test_recordings(fuzz, tmp_path, name):
    copy = tmp_path / "recording"
    shutil.copytree(RECORDING, copy)
    path = min((copy / "mav0").glob(name), key=lambda path: (len(path.name), path.name))
    seed = path.read_bytes()

    def run(data):
        path.write_bytes(data)
        for _ in zip(range(2), AslRecording(copy), strict=False):
            pass

    fuzz(run, [seed])


def read_whole(path, out):
    """Everything that tools do with a log."""
    log = open_log(path)
    log.facts()
    log.examine()
    for series in log.records():
        log.table(series)
    if path.suffix == ".mcap":
        recover(path, out)


@pytest.fixture
def flight_log(tmp_path, camera, pair):
    path = tmp_path / "seed.mcap"
    metadata = FlightMetadata(plan={}, seed=1, version="0.1.0", calibration=camera)
    with FlightLogWriter(path, metadata, images="stereo") as log:
        for stamp_ns in range(0, 300_000_000, 100_000_000):
            log.write_frame(StereoFrame(stamp_ns, pair.left, pair.right))
            log.write(Topic.TELEMETRY, Telemetry(stamp_ns=stamp_ns))
            log.write(Topic.PERCEPT, percept(stamp_ns))
    return path.read_bytes()


def percept(stamp_ns):
    figures = {"stereo_px": 2.0, "stereo_valid_norm": 0.5, "mono_px": 2.5, "mono_std_px": 0.1}
    return Percept(stamp_ns=stamp_ns, **figures)


def test_flight_logs(fuzz, tmp_path, flight_log):
    path = tmp_path / "flight.mcap"

    def run(data):
        path.write_bytes(data)
        read_whole(path, tmp_path / "out.mcap")
        log = FlightLog(path)
        for _ in log.frames():
            pass
        for _ in log.read(Topic.TELEMETRY, Telemetry):
            pass

    fuzz(run, [flight_log])


def test_telemetry_logs(fuzz, tmp_path):
    path = tmp_path / "flight.tlog"
    seed = b"".join(
        struct.pack(">Q", 1000 * number) + encode(message).packed(number, Source())
        for number, message in enumerate(messages())
    )

    def run(data):
        path.write_bytes(data)
        read_whole(path, tmp_path)

    fuzz(run, [seed])


def messages():
    found = [mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)]
    found += [mavlink.MAVLink_attitude_message(n, 0, 0, 0, 0, 0, 0.1) for n in range(5)]
    return [*found, mavlink.MAVLink_statustext_message(4, b"text")]


def test_px4_logs(fuzz, tmp_path):
    path = tmp_path / "flight.ulg"

    def message(kind, content):
        return struct.pack("<HB", len(content), ord(kind)) + content

    samples = [message("D", struct.pack("<HQ3f", 1, 20_000 * n, 0.0, 0.0, 0.1)) for n in range(5)]
    seed = b"".join(
        [
            b"ULog\x01\x12\x35\x01" + bytes(8),
            message("B", bytes(40)),
            message("F", b"vehicle_angular_velocity:uint64_t timestamp;float[3] xyz;"),
            message("I", b"\x10char[3] sys_namePX4"),
            message("A", struct.pack("<BH", 0, 1) + b"vehicle_angular_velocity"),
            *samples,
        ]
    )

    def run(data):
        path.write_bytes(data)
        read_whole(path, tmp_path)

    fuzz(run, [seed])


def test_log_records_with_sound_checksums(fuzz, tmp_path):
    """An MCAP file that is whole; one record's JSON is mutated."""
    path = tmp_path / "flight.mcap"
    header = {"plan": {}, "seed": 1, "version": "0.1.0"}
    fields = {key: json.dumps(value) for key, value in header.items()}

    def run(data):
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            writer.add_metadata(METADATA_NAME, fields)
            channel = writer.register_channel(Topic.TELEMETRY, "json", 0)
            writer.add_message(channel, 0, data, 0)
            writer.finish()
        log = FlightLog(path)
        log.columns(Topic.TELEMETRY)
        for _ in log.read(Topic.TELEMETRY, Telemetry):
            pass

    fuzz(run, [msgspec.json.encode(Telemetry(stamp_ns=3)), b'{"stamp_ns": 1}'])
