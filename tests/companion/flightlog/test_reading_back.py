"""What is written to the flight log is read as it was."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from companion.flightlog import FlightLog, FlightLogWriter, Topic
from companion.kernel.errors import RecordingError
from companion.kernel.messages import Decision, Setpoint, StereoFrame, Telemetry

NAN = math.nan
STEP_NS = 100_000_000
finite = st.floats(allow_nan=False, allow_infinity=False)


def same(one, other):
    """Equal as a user sees it: NaN equals NaN."""
    return repr(one) == repr(other)


def test_every_record_comes_back_as_it_was(tmp_path, metadata, records, write_flight):
    log = FlightLog(write_flight(tmp_path / "flight.mcap"))
    for topic in set(Topic) - {Topic.LEFT, Topic.RIGHT}:
        written = [record for name, record in records(30) if name == topic]
        assert same(list(log.read(topic, type(written[0]))), written)
    assert log.metadata == metadata
    assert not log.truncated


@given(values=st.tuples(finite | st.just(NAN), finite, finite), stamp_ns=st.integers(0, 2**53))
def test_any_number_survives(tmp_path_factory, values, stamp_ns, metadata):
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    written = Telemetry(stamp_ns=stamp_ns, position_ned_m=values, roll_rad=values[0])
    with FlightLogWriter(path, metadata) as log:
        log.write(Topic.TELEMETRY, written)
    assert same(list(FlightLog(path).read(Topic.TELEMETRY, Telemetry)), [written])


class Nested(msgspec.Struct):
    stamp_ns: int
    features: np.ndarray
    part: Setpoint
    optional_m: float | None = None
    series_m: list[float] = []


def test_new_record_types_need_no_registration(tmp_path, metadata):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, metadata) as log:
        for stamp_ns in (1, 2):
            features = np.array([1.0, NAN, stamp_ns], np.float32)
            log.write("/own", Nested(stamp_ns, features, Setpoint(stamp_ns=stamp_ns)))
    columns = FlightLog(path).columns("/own")
    np.testing.assert_array_equal(columns["features"], [[1, NAN, 1], [1, NAN, 2]])
    np.testing.assert_array_equal(columns["part.stamp_ns"], [1, 2])
    assert np.isnan(columns["optional_m"]).all()


def test_columns_have_the_types_of_their_fields(tmp_path, write_flight):
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


def test_a_part_that_was_not_there_at_first_is_a_column_of_nothing(tmp_path, metadata):
    """The first record says which columns there are."""
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, metadata) as log:
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


def test_a_record_of_another_clock_keeps_both_stamps(tmp_path, metadata):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, metadata) as log:
        log.write(Topic.TELEMETRY, Telemetry(stamp_ns=5), log_time_ns=70)
    with path.open("rb") as file:
        _, _, message = next(iter(make_reader(file).iter_messages()))
    assert (message.log_time, message.publish_time) == (70, 5)


def test_the_same_calls_give_the_same_bytes(tmp_path, write_flight):
    one, other = (write_flight(tmp_path / name).read_bytes() for name in ("1.mcap", "2.mcap"))
    assert one == other


def test_images_come_back_bit_for_bit(tmp_path, metadata):
    rng = np.random.default_rng(3)
    pairs = [rng.integers(0, 256, (2, 96, 128), dtype=np.uint8) for _ in range(4)]
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, metadata, images="stereo") as log:
        for i, (left, right) in enumerate(pairs):
            log.write_frame(StereoFrame(i * STEP_NS, left, right))
    frames = list(FlightLog(path).frames())
    assert [frame.stamp_ns for frame in frames] == [i * STEP_NS for i in range(4)]
    for frame, (left, right) in zip(frames, pairs, strict=True):
        np.testing.assert_array_equal(frame.left, left)
        np.testing.assert_array_equal(frame.right, right)


def test_frames_without_one_eye_are_left_out(tmp_path, metadata):
    image, nothing = np.zeros((96, 128), np.uint8), np.empty((0, 0), np.uint8)
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, metadata, images="stereo") as log:
        for number, (left, right) in enumerate(
            [(image, image), (nothing, image), (image, nothing), (image, image)]
        ):
            log.write_frame(StereoFrame(number, left, right))
    assert [frame.stamp_ns for frame in FlightLog(path).frames()] == [0, 3]


def test_without_images_frames_cost_nothing_and_reading_says_so(tmp_path, metadata, records):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, metadata) as log:
        log.write_frame(
            StereoFrame(0, np.zeros((96, 128), np.uint8), np.zeros((96, 128), np.uint8))
        )
    with pytest.raises(RecordingError, match=r"no records on /camera/right; it holds: none"):
        next(FlightLog(path).frames())


def test_a_topic_holds_one_type(tmp_path, metadata):
    with FlightLogWriter(tmp_path / "flight.mcap", metadata) as log:
        log.write("/one", Setpoint(stamp_ns=0))
        with pytest.raises(TypeError, match="/one holds Setpoint, not Telemetry"):
            log.write("/one", Telemetry())


def test_reading_as_another_type_names_the_field(tmp_path, write_flight):
    log = FlightLog(write_flight(tmp_path / "flight.mcap", 2))
    with pytest.raises(RecordingError, match=r"/percept: not a Decision: .*phase"):
        list(log.read(Topic.PERCEPT, Decision))
