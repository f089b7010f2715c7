"""What comes over sockets and on the command line: frames, MAVLink, lines of JSON, URLs."""

from collections import deque
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.camera.spec import parse_camera
from companion.kernel import wire
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import MocapPose, StereoFrame
from sitl.console import Console
from sitl.mavlink.framing import encode
from sitl.mavlink.link_url import Profile, parse_link
from sitl.mavlink.server import MavlinkServer
from sitl.pace import Pace
from sitl.parent import injected
from sitl.settings import SitlSettings
from sitl.simulator import World

EYE = Intrinsics(10.0, 10.0, 3.5, 2.5)
CAMERA = StereoCalibration(8, 6, EYE, EYE, 0.06)
FRAME = StereoFrame(5, *np.arange(96, dtype=np.uint8).reshape(2, 6, 8))
POSE = MocapPose(
    stamp_ns=1,
    truth_position_ned_m=(1.0, 2.0, -1.0),
    truth_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
    truth_clearance_m=0.4,
    truth_collisions=0,
)
FLIGHT_EXECUTIONS = 400
"""Then another vehicle takes over: after so many commands any is a wreck."""


def test_camera_frames(fuzz):
    topic, header, left, right = wire.encode_frame(FRAME, 1, CAMERA)

    def run(data):
        wire.decode_frame([topic, data, left, right])

    fuzz(run, [header])


def test_camera_images(fuzz):
    topic, header, left, right = wire.encode_frame(FRAME, 1, CAMERA)

    def run(data):
        wire.decode_frame([topic, header, *data.split(b"|")])

    fuzz(run, [left + b"|" + right])


def test_camera_truth(fuzz):
    topic, header = wire.encode_truth([POSE, POSE])
    fuzz(lambda data: wire.decode_truth([topic, data]), [header])


@pytest.mark.parametrize("parse", [parse_link, parse_camera], ids=["link", "camera"])
def test_urls(fuzz, parse):
    seeds = [
        b"udpout://127.0.0.1:14540?local_port=14580",
        b"udpin://:14550?profile=gcs&loss_norm=0.3&latency_s=0.3",
        b"serial:///dev/ttyS0:57600",
        b"tcpin://[::1]:5760",
        b"tcp://127.0.0.1:14590",
        b"device:0?calibration=camera.toml",
    ]
    fuzz(lambda data: parse(data.decode(errors="replace")), seeds)


@pytest.fixture(scope="module")
def hall():
    """A room without walls."""
    return SimpleNamespace(
        start_position_ned_m=(0.0, 0.0, 0.0),
        start_yaw_rad=0.0,
        nearest=lambda position_ned_m: (100.0, (1.0, 0.0, 0.0)),
    )


def test_lines_of_faults(fuzz, hall):
    world = World(hall, SitlSettings(), 1, hall)
    seeds = [
        b'{"wind_ned_m_s":[1,0,0],"charge_norm":0.5}',
        b'{"motor_efficiency_norm":[1,1,1,0.5],"link_loss_norm":0.3}',
    ]
    fuzz(lambda data: msgspec.json.encode(injected(world, data)), seeds)


def test_lines_of_the_console(fuzz, hall):
    world = World(hall, SitlSettings(), 1, hall)
    console = Console("tcp://127.0.0.1:0", world, Pace(1.0))
    seeds = [b"pause", b"step 5", b"run 0.5", b"speed 2", b"state", b"resume", b'{"charge_norm":1}']
    fuzz(lambda data: msgspec.json.encode(console._obey(data)), seeds)
    console.close()


class FarEnd:
    """A client and its link, in memory."""

    expected = True
    in_stream = False
    profile = Profile.GCS
    url = "memory"

    def __init__(self):
        self.clients = (self,)
        self.inbox = deque()

    def admit(self):
        return True

    def send(self, data):
        assert len(data) < 65536

    def filenos(self):
        return []

    def receive(self):
        return (self, self.inbox.popleft()) if self.inbox else None

    def close(self):
        pass


class Victim:
    """A vehicle in the air that takes whatever comes, and is replaced now and then."""

    def __init__(self, hall):
        self._hall = hall
        self._executions = 0
        self._begin()

    def _begin(self):
        self._world = World(self._hall, SitlSettings(), 1, self._hall)
        self._far = FarEnd()
        self._server = MavlinkServer(self._world.autopilot, [self._far])
        self._world.advance_to(3.0)
        self._world.autopilot.arm()
        self._world.autopilot.take_off(1.5)
        self._world.advance_to(12.0)

    def take(self, data):
        self._executions += 1
        if self._executions % FLIGHT_EXECUTIONS == 0 or self._world.crashed:
            self._begin()
        self._far.inbox.append(data)
        self._server.poll()
        self._world.step()
        self._server.update(self._world.time_s)
        position_ned_m = self._world.truth.position_ned_m
        assert all(abs(axis_m) < 2000.0 for axis_m in position_ned_m), position_ned_m


def obeyed():
    """One message of every kind that the vehicle obeys."""
    take_off = (1, 1, 0, 3, 22, 0, 1, 0, 0, 0, 0, 0, 0, 1.5)
    yield mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    for command in (16, 20, 21, 22, 176, 178, 179, 192, 400, 410, 420, 511, 512, 519, 34):
        yield mavlink.MAVLink_command_long_message(1, 1, command, 0, 1, 4, 3, 0, 0, 0, 1)
        yield mavlink.MAVLink_command_int_message(1, 1, 6, command, 0, 0, 1, 4, 3, 0, 0, 0, 1)
    yield mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 8, 1479, *(0.0, 0.0, 0.0), *(0.5, 0.0, 0.0), *(0.0, 0.0, 0.0), 0.0, 0.1
    )
    yield mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, [1, 0, 0, 0], 0, 0, 0, 0.5)
    yield mavlink.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0)
    yield mavlink.MAVLink_timesync_message(0, 5)
    yield mavlink.MAVLink_ping_message(0, 0, 0, 0)
    yield mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_P", 0.9, 9)
    yield mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_XY_P", -1)
    yield mavlink.MAVLink_param_request_list_message(1, 1)
    yield mavlink.MAVLink_mission_count_message(1, 1, 1)
    yield mavlink.MAVLink_mission_item_int_message(*take_off)
    yield mavlink.MAVLink_mission_item_message(*take_off)
    yield mavlink.MAVLink_mission_request_list_message(1, 1)
    yield mavlink.MAVLink_mission_request_int_message(1, 1, 0)
    yield mavlink.MAVLink_mission_set_current_message(1, 1, 0)
    yield mavlink.MAVLink_mission_clear_all_message(1, 1)
    yield mavlink.MAVLink_odometry_message(
        0, 1, 1, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, [0] * 21, [0] * 21
    )
    yield mavlink.MAVLink_vision_position_estimate_message(0, 0, 0, 0, 0, 0, 0)
    yield mavlink.MAVLink_att_pos_mocap_message(0, [1, 0, 0, 0], 0, 0, 0)


def test_mavlink_bytes(fuzz, hall):
    """The stream as it is: almost every mutation breaks a checksum."""
    codec = mavlink.MAVLink(None, 245, 190)
    frames = [message.pack(codec) for message in obeyed()]
    streams = [b"".join(frames[start : start + 4]) for start in range(0, len(frames), 4)]
    fuzz(Victim(hall).take, frames + streams)


def test_mavlink_payloads(fuzz, hall):
    """Messages with the right checksum around mutated payloads; the first byte says of which."""
    kinds = {}
    for message in obeyed():
        kinds.setdefault(message.get_msgId(), (len(kinds), message.crc_extra))
    ids = list(kinds)
    victim = Victim(hall)

    def run(data):
        message_id = ids[(data[0] if data else 0) % len(ids)]
        victim.take(framed(message_id, data[1:256] or b"\0", kinds[message_id][1]))

    seeds = [
        bytes((kinds[message.get_msgId()][0],)) + encode(message).payload for message in obeyed()
    ]
    fuzz(run, seeds)


def framed(message_id, payload, crc_extra):
    header = bytes((0xFD, len(payload), 0, 0, 0, 245, 190)) + message_id.to_bytes(3, "little")
    body = header + payload
    crc = mavlink.x25crc(body[1:] + bytes((crc_extra,))).crc
    return body + crc.to_bytes(2, "little")
