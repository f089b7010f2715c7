"""Flight logs as Foxglove and its like see them: known schemas, z up, not too many."""

import json
import math

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from companion.flightlog import FlightLog, FlightLogWriter, Topic
from companion.flightlog.records import pose_view
from companion.kernel.frames import euler_from_quaternion, quaternion_from_euler
from companion.kernel.messages import MocapPose, StereoFrame

REQUIRED = {
    "foxglove.CompressedImage": {"timestamp", "frame_id", "data", "format"},
    "foxglove.PoseInFrame": {"timestamp", "frame_id", "pose"},
    "foxglove.Log": {"timestamp", "level", "message", "name", "file", "line"},
}
"""Fields that the published JSON schemas require."""


def test_viewers_find_schemas_they_understand(tmp_path, metadata, write_flight):
    """What Foxglove's JSON schema reader wants: an object, no references, no nested arrays."""

    def check(schema):
        assert "$ref" not in schema
        assert schema["type"] in {"object", "array", "integer", "number", "boolean", "string"}
        if schema["type"] == "array":
            assert schema["items"]["type"] != "array"
        for child in [*schema.get("properties", {}).values(), *filter(None, [schema.get("items")])]:
            check(child)

    path = write_flight(tmp_path / "flight.mcap", 2)
    with FlightLogWriter(tmp_path / "images.mcap", metadata, images="stereo") as log:
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


def test_well_known_records_hold_all_that_viewers_require(tmp_path, metadata, records):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, metadata, images="stereo") as log:
        for topic, record in records(1):
            log.write(topic, record)
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


def test_views_are_thinned_records_are_not(tmp_path, metadata, records):
    path = tmp_path / "flight.mcap"
    with FlightLogWriter(path, metadata) as log:
        pose = next(record for topic, record in records(1) if topic == Topic.MOCAP)
        for i in range(100):  # a second at 100 Hz
            log.write(Topic.MOCAP, msgspec.structs.replace(pose, stamp_ns=i * 10_000_000))
    assert FlightLog(path).topics() == {"/mocap": 100, "/mocap/pose": 20}
