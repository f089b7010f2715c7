"""What a MAVLink client sees of the vehicle, over real sockets, flying in open air."""

import itertools
import math
import socket
import struct
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.errors import PlanError, SimulatorError
from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Ack
from sitl.mavlink import framing
from sitl.mavlink.links import UdpLink, parse_link
from sitl.mavlink.streams import STREAMS
from sitl.mavlink.tlog import TelemetryLog

ORBIT_STATUS = mavlink.MAVLINK_MSG_ID_ORBIT_EXECUTION_STATUS  # while in orbit only


@pytest.fixture
def flight(fly_mavlink):
    return fly_mavlink()


def test_streams_keep_their_rates_in_simulated_time(flight):
    counts = Counter(message.get_msgId() for message in flight.run(10.0))
    for message_id, stream in STREAMS.items():
        expected = stream.onboard_hz * 10.0 if message_id != ORBIT_STATUS else 0.0
        assert counts[message_id] == pytest.approx(expected, abs=1.0, rel=0.02), message_id


def test_sequence_numbers_have_no_gaps(flight):
    numbers = [message.get_seq() for message in flight.run(3.0)]
    assert all((b - a) % 256 == 1 for a, b in itertools.pairwise(numbers))


def test_motion_messages_tell_the_estimate(flight):
    latest = {message.get_type(): message for message in flight.run(3.0)}
    estimate = flight.autopilot.estimate
    assert latest["ATTITUDE"].yaw == pytest.approx(0.5, abs=0.1)
    assert latest["ATTITUDE"].time_boot_ms == pytest.approx(estimate.time_s * 1e3, abs=25)
    position = latest["LOCAL_POSITION_NED"]
    assert (position.x, position.y) == pytest.approx(estimate.position_ned_m[:2], abs=0.05)
    assert latest["HIGHRES_IMU"].zacc == pytest.approx(-9.81, abs=0.5)
    assert latest["GPS_RAW_INT"].fix_type == mavlink.GPS_FIX_TYPE_NO_FIX
    assert latest["SYS_STATUS"].battery_remaining > 90


def test_heartbeat_carries_px4s_numbers(flight):
    def heartbeat():
        return [m for m in flight.run(1.01) if m.get_type() == "HEARTBEAT"][-1]

    flight.run(2.5)
    at_rest = heartbeat()
    assert (at_rest.base_mode, at_rest.custom_mode) == (29, 0x03040000)
    assert (at_rest.type, at_rest.autopilot, at_rest.system_status) == (2, 12, 3)
    flight.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    armed = heartbeat()
    assert (armed.base_mode, armed.system_status) == (157, 4)


def test_arming_is_refused_until_the_estimator_is_ready(flight):
    arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert flight.acks(arm, 1.0) == [Ack.TEMPORARILY_REJECTED]
    flight.run(3.0)
    assert flight.acks(arm, 1.0) == [Ack.ACCEPTED]
    assert flight.acks(arm, 0.0) == [Ack.ACCEPTED]
    assert flight.acks(arm, 7.0) == [Ack.DENIED]


def test_command_int_is_understood_and_unknown_commands_are_unsupported(flight):
    flight.run(3.0)
    flight.client.received()
    arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    flight.client.send(
        mavlink.MAVLink_command_int_message(1, 1, 0, arm, 0, 0, 1.0, 0.0, 0.0, 0.0, 0, 0, 0.0)
    )
    assert [m.result for m in flight.answers("COMMAND_ACK")] == [Ack.ACCEPTED]
    assert flight.autopilot.status.armed
    assert flight.acks(mavlink.MAV_CMD_DO_DIGICAM_CONTROL) == [Ack.UNSUPPORTED]


def test_commands_to_another_system_are_ignored(flight):
    message = mavlink.MAVLink_command_long_message(9, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)
    flight.client.send(message)
    assert flight.answers("COMMAND_ACK") == []


def test_offboard_needs_setpoints_and_has_two_acks(flight):
    flight.take_off()
    offboard = (mavlink.MAV_CMD_DO_SET_MODE, 129.0, 6.0, 0.0)
    assert flight.acks(*offboard) == [Ack.ACCEPTED, Ack.TEMPORARILY_REJECTED]
    flight.send_setpoint((0.0, 0.0, 0.0))
    assert flight.acks(*offboard) == [Ack.ACCEPTED, Ack.ACCEPTED]
    assert flight.autopilot.status.mode is FlightMode.OFFBOARD
    assert flight.acks(mavlink.MAV_CMD_DO_SET_MODE, 129.0, 4.0, 3.0) == [Ack.ACCEPTED] * 2
    assert flight.autopilot.status.mode is FlightMode.HOLD


def test_a_body_velocity_flies_along_the_heading(flight):
    flight.take_off()
    flight.send_setpoint((0.5, 0.0, 0.0))
    flight.acks(mavlink.MAV_CMD_DO_SET_MODE, 129.0, 6.0, 0.0)
    for _ in range(20):
        flight.send_setpoint((0.5, 0.0, 0.0))
        flight.run(0.2)
    north_m_s, east_m_s, _ = flight.world.truth.velocity_ned_m_s
    assert math.hypot(north_m_s, east_m_s) == pytest.approx(0.5, abs=0.05)
    yaw_rad = flight.world.truth.euler_rad[2]
    assert math.atan2(east_m_s, north_m_s) == pytest.approx(yaw_rad, abs=0.1)


def test_landing_disarms(flight):
    flight.take_off()
    assert flight.acks(mavlink.MAV_CMD_NAV_LAND) == [Ack.ACCEPTED]
    flight.run(10.0)
    assert not flight.autopilot.status.armed


def test_message_rates_can_be_set_for_one_link_alone(flight):
    other = flight.new_client(1)
    set_interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    assert flight.acks(set_interval, mavlink.MAVLINK_MSG_ID_ATTITUDE, 2e5) == [Ack.ACCEPTED]
    assert flight.acks(set_interval, mavlink.MAVLINK_MSG_ID_ODOMETRY, -1.0) == [Ack.ACCEPTED]
    assert flight.acks(set_interval, 9999.0, 1e5) == [Ack.DENIED]
    counts = Counter(message.get_type() for message in flight.run(1.0))
    others = Counter(message.get_type() for message in other.received())
    other.close()
    assert counts["ATTITUDE"] == pytest.approx(5, abs=1)
    assert counts["ODOMETRY"] == 0
    assert others["ATTITUDE"] == pytest.approx(100, abs=2)


def test_a_message_can_be_requested(flight):
    request = mavlink.MAV_CMD_REQUEST_MESSAGE
    flight.client.command(request, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    (version,) = flight.answers("AUTOPILOT_VERSION")
    assert version.flight_sw_version >> 16 == 1 << 8 | 17
    assert flight.acks(request, 9999.0) == [Ack.DENIED]


def test_parameters_are_read_and_set_bytewise(flight):
    def value_of(name):
        flight.client.send(mavlink.MAVLink_param_request_read_message(1, 1, name, -1))
        (answer,) = flight.answers("PARAM_VALUE")
        return answer

    height = value_of(b"MIS_TAKEOFF_ALT")
    assert (height.param_value, height.param_type) == (2.5, mavlink.MAV_PARAM_TYPE_REAL32)
    action = value_of(b"COM_OBL_RC_ACT")
    assert action.param_type == mavlink.MAV_PARAM_TYPE_INT32
    five = struct.unpack("<f", (5).to_bytes(4, "little"))[0]
    flight.client.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", five, 6))
    flight.answers("PARAM_VALUE")
    assert flight.autopilot.parameters["COM_OBL_RC_ACT"] == 5
    flight.client.send(mavlink.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 1.5, 9))
    assert [m.param_value for m in flight.answers("PARAM_VALUE")] == [1.5]


def test_all_parameters_are_listed_and_unknown_names_met_with_silence(flight):
    flight.client.send(mavlink.MAVLink_param_request_list_message(1, 1))
    values = flight.answers("PARAM_VALUE")
    hash_check, *values = values
    assert hash_check.param_id == "_HASH_CHECK"
    assert [m.param_id for m in values] == list(flight.autopilot.parameters)
    assert [m.param_index for m in values] == list(range(values[0].param_count))
    flight.client.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_NAME", -1))
    assert flight.answers("PARAM_VALUE") == []


def test_status_texts_go_to_ground_stations_only(flight):
    station = flight.new_client(1, kind=mavlink.MAV_TYPE_GCS)
    mine, theirs = [], []
    for _ in range(6):
        mine += flight.run(0.5)
        theirs += station.received()
    station.close()
    assert "Ready for takeoff!" in [m.text for m in theirs if m.get_type() == "STATUSTEXT"]
    assert not [m for m in mine if m.get_type() == "STATUSTEXT"]


def test_timesync_and_ping_are_answered(flight):
    flight.run(1.0)
    flight.client.send(mavlink.MAVLink_timesync_message(0, 12345))
    (answer,) = flight.answers("TIMESYNC")
    assert answer.ts1 == 12345
    assert answer.tc1 == pytest.approx(1e9, rel=0.05)
    flight.client.send(mavlink.MAVLink_ping_message(7, 8, 0, 0))
    (answer,) = flight.answers("PING")
    assert (answer.time_usec, answer.seq) == (7, 8)
    assert (answer.target_system, answer.target_component) == (245, 190)


def test_the_log_holds_all_that_went_over_the_first_link(tmp_path, fly_mavlink):
    def fly(path):
        flight = fly_mavlink(log=TelemetryLog(path))
        flight.client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        received = flight.run(2.0)
        flight.close()
        return received

    received = fly(tmp_path / "a.tlog")
    fly(tmp_path / "b.tlog")
    assert (tmp_path / "a.tlog").read_bytes() == (tmp_path / "b.tlog").read_bytes()
    log = mavutil.mavlogfile(str(tmp_path / "a.tlog"), robust_parsing=False)
    logged = []
    while (message := log.recv_msg()) is not None:
        logged.append(message)
    log.f.close()
    assert [m.get_type() for m in logged if m.get_srcSystem() == 1] == [
        m.get_type() for m in received
    ]
    assert [m.command for m in logged if m.get_type() == "COMMAND_LONG"] == [400]
    assert logged[-1]._timestamp == pytest.approx(2.0, abs=0.02)


def packed(message, sequence=0):
    return framing.encode(message).packed(sequence, framing.Source())


@given(sequence=st.integers(0, 255), time_ms=st.integers(0, 2**32 - 1))
def test_a_renumbered_frame_is_the_frame_with_that_number(sequence, time_ms):
    message = mavlink.MAVLink_system_time_message(0, time_ms)
    codec = mavlink.MAVLink(None, 1, 1)
    codec.seq = sequence
    assert packed(message, sequence) == message.pack(codec)


@given(st.binary(max_size=40).filter(lambda b: b"\xfd" not in b and b"\xfe" not in b))
def test_frames_are_found_behind_garbage(garbage):
    frame = packed(mavlink.MAVLink_system_time_message(0, 77))
    found = list(framing.split(garbage + frame + frame))
    assert found == [frame, frame]
    assert framing.decode(frame).time_boot_ms == 77


@given(st.binary(max_size=200))
def test_any_datagram_is_survived(datagram):
    for frame in framing.split(datagram):
        framing.decode(frame)


def test_a_damaged_frame_is_dropped():
    frame = bytearray(packed(mavlink.MAVLink_system_time_message(0, 77)))
    frame[-3] ^= 1
    assert framing.decode(bytes(frame)) is None


def test_a_busy_port_is_one_clear_error():
    first = UdpLink("udpin://127.0.0.1:0")
    with pytest.raises(SimulatorError, match=r"^udpin://127.0.0.1:\d+: cannot use .* in use$"):
        UdpLink(first.url)
    first.close()


@pytest.mark.parametrize(
    "url",
    [
        *("", "127.0.0.1:14540", "tcp://a:1", "udpin://", "udpout://h:70000", "udpout://:1"),
        *("udpout://h:1?local=2", "udpin://:1?profile=fast", "serial://ttyX", "serial:///dev/x:b"),
    ],
)
def test_a_bad_url_is_refused_with_what_is_allowed(url):
    with pytest.raises(PlanError, match="use udpout://HOST:PORT"):
        parse_link(url)


def test_udpout_speaks_first_from_its_local_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(1.0)
        host, port = listener.getsockname()
        link = UdpLink(f"udpout://{host}:{port}")
        link.clients[0].send(b"hello")
        assert listener.recv(10) == b"hello"
        link.close()
