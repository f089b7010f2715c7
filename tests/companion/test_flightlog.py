"""The flight log: what is written is read, whatever ended the flight."""

import json
import math
import resource
import signal
import subprocess
import sys

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from companion.flightlog import FlightLog, FlightLogWriter, FlightMetadata, Topic
from companion.flightlog.records import pose_view
from companion.health.words import PLACES
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import RecordingError
from companion.kernel.frames import euler_from_quaternion, quaternion_from_euler
from companion.kernel.messages import (
    BehaviourState,
    Cue,
    Decision,
    Event,
    Health,
    MocapPose,
    MonoMap,
    Percept,
    Phase,
    Setpoint,
    StereoFrame,
    Telemetry,
    TrustFigures,
    TrustStatus,
)

NAN = math.nan
EYE = Intrinsics(100.0, 100.0, 64.0, 48.0)
META = FlightMetadata(
    plan={"seed": 7, "camera": {"rate_hz": 10.0}},
    seed=7,
    version="0.1.0",
    calibration=StereoCalibration(128, 96, EYE, EYE, 0.06),
)
STEP_NS = 100_000_000
finite = st.floats(allow_nan=False, allow_infinity=False)


def records(n):
    """``n`` frames' worth of every record type of a flight."""
    for stamp_ns in range(0, n * STEP_NS, STEP_NS):
        yield Topic.TELEMETRY, Telemetry(stamp_ns=stamp_ns, yaw_rad=0.25, armed=True)
        yield (
            Topic.PERCEPT,
            Percept(
                stamp_ns=stamp_ns,
                stereo_px=stamp_ns * 1e-9,
                stereo_valid_norm=0.5,
                mono_px=NAN,
                mono_std_px=NAN,
            ),
        )
        yield (
            Topic.DECISION,
            Decision(
                stamp_ns=stamp_ns,
                phase=Phase.LEARNING,
                cue=Cue.MONO,
                override=False,
                disparity_px=3.5,
                threshold_px=8.0,
                state=BehaviourState.STRAIGHT,
                overrides=0,
                turns=2,
                approaches=3,
            ),
        )
        yield Topic.SETPOINT, Setpoint(stamp_ns=stamp_ns, velocity_hfrd_m_s=(0.5, 0.0, -0.1))
        yield (
            Topic.MOCAP,
            MocapPose(
                stamp_ns=stamp_ns,
                truth_position_ned_m=(1.0, 2.0, -3.0),
                truth_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
                truth_clearance_m=0.8,
                truth_collisions=0,
            ),
        )
    yield Topic.EVENT, Event(stamp_ns=n * STEP_NS, severity="info", text="done")
    yield Topic.HEALTH, an_eye_is_black(n * STEP_NS)
    yield Topic.TRUST, TrustFigures(stamp_ns=n * STEP_NS, status=TrustStatus.LEARNING, auc=0.5)
    yield Topic.MAP, MonoMap(stamp_ns=n * STEP_NS, columns=2, disparity_px=(1.5, NAN))


def an_eye_is_black(stamp_ns):
    names = [f"{place}_{what}" for place in PLACES for what in ("fault", "evidence")]
    said = dict.fromkeys(names, "") | {"left_fault": "black", "left_evidence": "all of it"}
    return Health(stamp_ns=stamp_ns, stereo=False, left=False, right=True, **said)


def write_flight(path, n=30):
    with FlightLogWriter(path, META) as log:
        write_all(log, records(n))
    return path


def write_all(log, items):
    for topic, record in items:
        log.write(topic, record)


def same(one, other):
    """Equal as a user sees it: NaN equals NaN."""
    return repr(one) == repr(other)


def test_every_record_comes_back_as_it_was(tmp_path):
    log = FlightLog(write_flight(tmp_path / "flight.mcap"))
    for topic in set(Topic) - {Topic.LEFT, Topic.RIGHT}:
        written = [record for name, record in records(30) if name == topic]
        assert same(list(log.read(topic, type(written[0]))), written)
    assert log.metadata == META
    assert not log.truncated


@given(values=st.tuples(finite | st.just(NAN), finite, finite), stamp_ns=st.integers(0, 2**53))
def test_any_number_survives(tmp_path_factory, values, stamp_ns):
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    written = Telemetry(stamp_ns=stamp_ns, position_ned_m=values, roll_rad=values[0])
    with FlightLogWriter(path, META) as log:
        log.write(Topic.TELEMETRY, written)
    assert same(list(FlightLog(path).read(Topic.TELEMETRY, Telemetry)), [written])


class Nested(msgspec.Struct):
    stamp_ns: int
    features: np.ndarray
    part: Setpoint
    optional_m: float | None = None
    series_m: list[float] = []


def test_new_record_types_need_no_registration(tmp_path):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, META) as log:
        for stamp_ns in (1, 2):
            features = np.array([1.0, NAN, stamp_ns], np.float32)
            log.write("/own", Nested(stamp_ns, features, Setpoint(stamp_ns=stamp_ns)))
    columns = FlightLog(path).columns("/own")
    np.testing.assert_array_equal(columns["features"], [[1, NAN, 1], [1, NAN, 2]])
    np.testing.assert_array_equal(columns["part.stamp_ns"], [1, 2])
    assert np.isnan(columns["optional_m"]).all()


def test_columns_have_the_types_of_their_fields(tmp_path):
    log = FlightLog(write_flight(tmp_path / "flight.mcap", 5))
    telemetry = log.columns(Topic.TELEMETRY)
    assert telemetry["stamp_ns"].tolist() == [i * STEP_NS for i in range(5)]
    assert telemetry["position_ned_m"].shape == (5, 3)
    assert np.isnan(telemetry["position_ned_m"]).all()
    assert telemetry["armed"].dtype == bool
    percept = log.columns(Topic.PERCEPT)
    assert percept["stereo_px"].dtype == np.float64
    assert np.isnan(percept["mono_px"]).all()
    assert set(log.columns(Topic.DECISION)["cue"]) == {"mono"}


class Step(msgspec.Struct):
    stamp_ns: int
    goal: Setpoint | None = None


def test_a_part_that_was_not_there_at_first_is_a_column_of_nothing(tmp_path):
    """The first record says which columns there are."""
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, META) as log:
        log.write("/own", Step(1))
        log.write("/own", Step(2, Setpoint(stamp_ns=2)))
    columns = FlightLog(path).columns("/own")
    assert columns["stamp_ns"].tolist() == [1, 2]
    assert set(columns) == {"stamp_ns", "goal"}
    assert np.isnan(columns["goal"]).all()


def test_several_topics_are_read_as_each_alone(whole_log):
    log = FlightLog(whole_log)
    topics = (Topic.DECISION, Topic.EVENT, Topic.MOCAP)
    for topic, columns in zip(topics, log.tables(*topics), strict=True):
        np.testing.assert_equal(columns, log.columns(topic))


@given(stamps_ns=st.lists(st.integers(-STEP_NS, 62 * STEP_NS), min_size=1))
def test_the_nearest_record_has_the_nearest_stamp(whole_log, stamps_ns):
    log = FlightLog(whole_log)
    every_ns = log.columns(Topic.MOCAP)["stamp_ns"]
    nearest = log.nearest(Topic.MOCAP, np.array(stamps_ns))
    assert nearest["truth_position_ned_m"].shape == (len(stamps_ns), 3)
    for stamp_ns, found_ns in zip(stamps_ns, nearest["stamp_ns"], strict=True):
        assert abs(stamp_ns - found_ns) == abs(stamp_ns - every_ns).min()


def test_a_record_of_another_clock_keeps_both_stamps(tmp_path):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, META) as log:
        log.write(Topic.TELEMETRY, Telemetry(stamp_ns=5), log_time_ns=70)
    with path.open("rb") as file:
        _, _, message = next(iter(make_reader(file).iter_messages()))
    assert (message.log_time, message.publish_time) == (70, 5)


def test_the_same_calls_give_the_same_bytes(tmp_path):
    one, other = (write_flight(tmp_path / name).read_bytes() for name in ("1.mcap", "2.mcap"))
    assert one == other


def test_viewers_find_schemas_they_understand(tmp_path):
    """What Foxglove's JSON schema reader wants: an object, no references, no nested arrays."""

    def check(schema):
        assert "$ref" not in schema
        assert schema["type"] in {"object", "array", "integer", "number", "boolean", "string"}
        if schema["type"] == "array":
            assert schema["items"]["type"] != "array"
        for child in [*schema.get("properties", {}).values(), *filter(None, [schema.get("items")])]:
            check(child)

    path = write_flight(tmp_path / "flight.mcap", 2)
    with FlightLogWriter(tmp_path / "images.mcap", META, images="stereo") as log:
        log.write_frame(StereoFrame(0, np.zeros((96, 128), np.uint8), np.ones((96, 128), np.uint8)))
    names = {}
    for file_path in (path, tmp_path / "images.mcap"):
        with file_path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                described = json.loads(schema.data)
                check(described)
                assert set(json.loads(message.data)) == set(described["properties"])
                names[channel.topic] = schema.name
    assert names["/mocap/pose"] == "foxglove.PoseInFrame"
    assert names["/event/log"] == "foxglove.Log"
    assert names["/camera/left"] == "foxglove.CompressedImage"
    assert names["/percept"] == "Percept"


@pytest.mark.parametrize("yaw_rad", [-3.0, -0.7, 0.0, 1.2])
def test_poses_are_shown_with_z_up(yaw_rad):
    """Yaw in NED counts from north, clockwise; in ENU from east, counter-clockwise."""
    pose = MocapPose(
        stamp_ns=1_500_000_000,
        truth_position_ned_m=(1.0, 2.0, -3.0),
        truth_ned_from_frd=quaternion_from_euler(0.1, -0.2, yaw_rad),
        truth_clearance_m=1.0,
        truth_collisions=0,
    )
    shown = pose_view(pose)
    q = shown.pose.orientation
    euler = euler_from_quaternion((q.w, q.x, q.y, q.z))
    expected = (0.1, 0.2, math.remainder(math.pi / 2 - yaw_rad, math.tau))
    assert euler == pytest.approx(expected)
    assert (shown.pose.position.x, shown.pose.position.y, shown.pose.position.z) == (2, 1, 3)
    assert (shown.timestamp.sec, shown.timestamp.nsec) == (1, 500_000_000)


def test_views_are_thinned_records_are_not(tmp_path):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, META) as log:
        pose = next(record for topic, record in records(1) if topic == Topic.MOCAP)
        for i in range(100):  # a second at 100 Hz
            log.write(Topic.MOCAP, msgspec.structs.replace(pose, stamp_ns=i * 10_000_000))
    assert FlightLog(path).topics() == {"/mocap": 100, "/mocap/pose": 20}


def test_images_come_back_bit_for_bit(tmp_path):
    rng = np.random.default_rng(3)
    pairs = [rng.integers(0, 256, (2, 96, 128), dtype=np.uint8) for _ in range(4)]
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, META, images="stereo") as log:
        for i, (left, right) in enumerate(pairs):
            log.write_frame(StereoFrame(i * STEP_NS, left, right))
    frames = list(FlightLog(path).frames())
    assert [frame.stamp_ns for frame in frames] == [i * STEP_NS for i in range(4)]
    for frame, (left, right) in zip(frames, pairs, strict=True):
        np.testing.assert_array_equal(frame.left, left)
        np.testing.assert_array_equal(frame.right, right)


def test_frames_without_one_eye_are_left_out(tmp_path):
    image, nothing = np.zeros((96, 128), np.uint8), np.empty((0, 0), np.uint8)
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, META, images="stereo") as log:
        for number, (left, right) in enumerate(
            [(image, image), (nothing, image), (image, nothing), (image, image)]
        ):
            log.write_frame(StereoFrame(number, left, right))
    assert [frame.stamp_ns for frame in FlightLog(path).frames()] == [0, 3]


def test_without_images_frames_cost_nothing_and_reading_says_so(tmp_path):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, META) as log:
        log.write_frame(
            StereoFrame(0, np.zeros((96, 128), np.uint8), np.zeros((96, 128), np.uint8))
        )
    with pytest.raises(RecordingError, match=r"no records on /camera/right; it holds: none"):
        next(FlightLog(path).frames())


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
        assert same(read, whole[: len(read)])


@pytest.fixture(scope="module")
def whole_log(tmp_path_factory):
    return write_flight(tmp_path_factory.mktemp("whole") / "flight.mcap", 60)


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


def test_a_killed_process_loses_at_most_a_second(tmp_path):
    path = tmp_path / "flight.mcap"
    killed = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert killed.returncode == -signal.SIGKILL
    log = FlightLog(path)
    assert log.truncated
    stamps_ns = log.columns("/telemetry")["stamp_ns"]
    assert stamps_ns[-1] >= 99 * STEP_NS - 1_000_000_000


def test_a_full_disk_is_one_error_and_leaves_a_log(tmp_path):
    path = tmp_path / "flight.mcap"
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    log = FlightLogWriter(path, META, patient=True)
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


REQUIRED = {
    "foxglove.CompressedImage": {"timestamp", "frame_id", "data", "format"},
    "foxglove.PoseInFrame": {"timestamp", "frame_id", "pose"},
    "foxglove.Log": {"timestamp", "level", "message", "name", "file", "line"},
}
"""Fields that the published JSON schemas require."""


def test_well_known_records_hold_all_that_viewers_require(tmp_path):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, META, images="stereo") as log:
        write_all(log, records(1))
        log.write_frame(StereoFrame(0, np.zeros((4, 4), np.uint8), np.zeros((4, 4), np.uint8)))
    with path.open("rb") as file:
        seen = {
            schema.name: json.loads(message.data)
            for schema, _, message in make_reader(file).iter_messages()
            if schema.name in REQUIRED
        }
    assert {name: REQUIRED[name] <= set(record) for name, record in seen.items()} == dict.fromkeys(
        REQUIRED, True
    )


def test_closing_twice_is_safe(tmp_path):
    with FlightLogWriter(tmp_path / "flight.mcap", META) as log:
        log.close()
    assert not FlightLog(tmp_path / "flight.mcap").truncated


def test_a_topic_holds_one_type(tmp_path):
    with FlightLogWriter(tmp_path / "flight.mcap", META) as log:
        log.write("/one", Setpoint(stamp_ns=0))
        with pytest.raises(TypeError, match="/one holds Setpoint, not Telemetry"):
            log.write("/one", Telemetry())


def test_the_folder_must_exist(tmp_path):
    with pytest.raises(RecordingError, match="cannot be written: No such file"):
        FlightLogWriter(tmp_path / "none" / "flight.mcap", META)


HEADER = {
    name: msgspec.json.encode(getattr(META, name)).decode() for name in META.__struct_fields__
}
WRITERS = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "without chunks": {"use_chunking": False},
    "without an index": {"index_types": IndexType.NONE},
    "without an index of messages": {"index_types": IndexType.CHUNK},
}


def write_as_others_do(path, **options):
    """Two topics, a chunk every few records."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=500, **options)
        writer.start()
        writer.add_metadata("flight", HEADER)
        channels = [writer.register_channel(topic, "json", 0) for topic in ("/a", "/b")]
        for number in range(50):
            record = msgspec.json.encode({"stamp_ns": number, "text": "some words " * 3})
            writer.add_message(channels[number % 2], number + 1000, record, number)
        writer.finish()


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("share", [1.0, 0.6])
def test_other_writers_files_are_read_alike(tmp_path, kind, share):
    path = tmp_path / "flight.mcap"
    write_as_others_do(path, **WRITERS[kind])
    data = path.read_bytes()
    path.write_bytes(data[: round(share * len(data))])
    log = FlightLog(path)
    stamps_ns = log.columns("/b")["stamp_ns"].tolist()
    assert stamps_ns == list(range(1, 50, 2))[: len(stamps_ns)]
    assert len(stamps_ns) == log.topics()["/b"]
    assert (log.log_times_ns("/b") - stamps_ns == 1000).all()
    assert (len(stamps_ns) == 25) == (share == 1.0)
    assert len(stamps_ns) > 5


def test_a_record_that_reaches_beyond_its_chunk_is_damage(tmp_path):
    path = tmp_path / "flight.mcap"
    write_as_others_do(path, compression=CompressionType.NONE, enable_crcs=False)
    data = bytearray(path.read_bytes())
    length_at = data.index(b'{"stamp_ns":20,') - 22 - 8
    assert data[length_at - 1] == 0x05  # a message
    data[length_at : length_at + 8] = (1 << 40).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="damaged: a record reaches beyond its chunk"):
        FlightLog(path).columns("/a")


def foreign_mcap(path):
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


def test_reading_as_another_type_names_the_field(tmp_path):
    log = FlightLog(write_flight(tmp_path / "flight.mcap", 2))
    with pytest.raises(RecordingError, match=r"/percept: not a Decision: .*phase"):
        list(log.read(Topic.PERCEPT, Decision))
