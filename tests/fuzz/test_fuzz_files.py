"""Files: plans, rooms, models, recordings, logs, parameters. Success, or one line that says why."""

import io
import json
import shutil
import struct
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.writer import Writer
from pymavlink.dialects.v20 import common as mavlink

from companion.camera.asl import AslRecording
from companion.camera.spec import load_calibration
from companion.flightlog import FlightLog, FlightLogWriter, FlightMetadata, Topic
from companion.flightlog.records import METADATA_NAME
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import Percept, StereoFrame, Telemetry
from companion.kernel.settings import convert_settings
from companion.learner import Learner
from companion.learner_settings import LearnerSettings
from companion.modelfile import load_dictionary, load_model, save_model
from companion.pipeline import Pipeline
from companion.plan import load_plan, room_path
from sitl.arena.contact import RoomContact
from sitl.arena.room import load_room
from sitl.mavlink.framing import Source, encode
from sitl.mavlink.parameter_file import ParameterFile
from sitl.mavlink.signing import read_key
from sitl.options import read_settings
from sitl.settings import SitlSettings
from tools.campaign.plan import load_campaign
from tools.logs.opening import open_log
from tools.logs.recover import recover

ROOT = Path(__file__).parents[2]
PLANS = ROOT / "flightplans"
RECORDING = ROOT / "tests" / "data" / "room1"
EYE = Intrinsics(100.0, 100.0, 64.0, 48.0)
CAMERA = StereoCalibration(128, 96, EYE, EYE, 0.06)
CALIBRATION = b"""width_px = 128
height_px = 96
baseline_m = 0.06
left = { focal_x_px = 100.0, focal_y_px = 100.0, centre_x_px = 64.0, centre_y_px = 48.0 }
right = { focal_x_px = 100.0, focal_y_px = 100.0, centre_x_px = 64.0, centre_y_px = 48.0 }
"""


def contents(pattern):
    return [path.read_bytes() for path in sorted(PLANS.glob(pattern))]


@pytest.fixture
def pair():
    left, right = np.random.default_rng(1).integers(0, 256, (2, 96, 128), dtype=np.uint8)
    return StereoFrame(0, left, right)


def test_plans(fuzz, tmp_path, pair):
    (tmp_path / "rooms").symlink_to(PLANS / "rooms")
    path = tmp_path / "mine.toml"

    def run(data):
        path.write_bytes(data)
        plan = load_plan(path)
        room_path(plan, path)
        convert_settings(plan.sitl, SitlSettings, "sitl")
        Pipeline(plan, CAMERA).step(pair, Telemetry(stamp_ns=0))

    fuzz(run, contents("*.toml"))


def test_overrides(fuzz):
    def run(data):
        load_plan(None, [data.decode(errors="replace")])

    keys = b"experiment.scheme=dagger", b"sitl.wind_ned_m_s=[1, 0, 0]", b"seed = 9", b"a.b.c=true"
    fuzz(run, keys)


def test_rooms(fuzz, tmp_path):
    path = tmp_path / "mine.toml"

    def run(data):
        path.write_bytes(data)
        RoomContact(load_room(path)).nearest((0.1, 0.1, -1.0))

    fuzz(run, contents("rooms/*.toml"))


def test_campaigns(fuzz, tmp_path):
    shutil.copytree(PLANS, tmp_path / "flightplans")
    path = tmp_path / "flightplans" / "campaigns" / "mine.toml"

    def run(data):
        path.write_bytes(data)
        load_campaign(path, runs=1)

    fuzz(run, contents("campaigns/*.toml"))


def test_calibrations(fuzz, tmp_path):
    path = tmp_path / "camera.toml"

    def run(data):
        path.write_bytes(data)
        load_calibration(path)

    fuzz(run, [CALIBRATION])


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_simulator_settings(fuzz, tmp_path, suffix):
    path = tmp_path / f"sitl{suffix}"

    def run(data):
        path.write_bytes(data)
        convert_settings(read_settings(path), SitlSettings, "sitl")

    fuzz(run, [b'{"battery": {"charge_norm": 0.5}}', b"[battery]\ncharge_norm = 0.5\n", b"[]"])


def test_parameter_files(fuzz, tmp_path):
    path = tmp_path / "saved.params"
    saved = ParameterFile(path)
    saved.save(saved.last)
    seed = path.read_bytes()

    def run(data):
        path.write_bytes(data)
        ParameterFile(path)

    fuzz(run, [seed, b"1 1 MPC_XY_P 0.8 9\n"])


def test_signing_keys(fuzz, tmp_path):
    path = tmp_path / "key"

    def run(data):
        path.write_bytes(data)
        read_key(path)

    fuzz(run, [bytes(range(32)), bytes(range(32)).hex().encode()])


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A saved model of a learner that has seen a little."""
    rng = np.random.default_rng(1)
    learner = Learner(LearnerSettings(), rng)
    for _ in range(60):
        features = learner.observe(rng.integers(0, 256, (96, 128), dtype=np.uint8))
        if features is not None:
            learner.learn(features, 2.0)
    path = tmp_path_factory.mktemp("model") / "model.npz"
    save_model(path, learner.state(), CAMERA)
    return path.read_bytes()


def take_up(path):
    load_dictionary(path)
    learner = Learner(LearnerSettings(), np.random.default_rng(1)).restore(
        load_model(path, CAMERA).state
    )
    learner.predict(learner.observe(np.zeros((96, 128), np.uint8)))


def test_models(fuzz, tmp_path, model):
    path = tmp_path / "model.npz"

    def run(data):
        path.write_bytes(data)
        take_up(path)

    fuzz(run, [model])


def test_models_of_sound_files(fuzz, tmp_path, model):
    """A file as we write it; one of its arrays is not what was learned."""
    path = tmp_path / "model.npz"
    path.write_bytes(model)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "header.json"}
    names = sorted(arrays)
    state = load_model(path, CAMERA).state

    def run(data):
        name = names[data[0] % len(names)] if data else names[0]
        try:
            spoilt = np.load(io.BytesIO(data[1:]), allow_pickle=False)
        except Exception:  # noqa: BLE001 - numpy's own reader is not what is tested here
            return
        save_model(path, state._replace(arrays={**state.arrays, name: spoilt}), CAMERA)
        take_up(path)

    fuzz(run, [bytes((number,)) + npy(arrays[name]) for number, name in enumerate(names)])


def npy(array):
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


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
def flight_log(tmp_path, pair):
    path = tmp_path / "seed.mcap"
    metadata = FlightMetadata(plan={}, seed=1, version="0.1.0", calibration=CAMERA)
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
