"""What commands do, beyond their answers."""

import math

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Ack
from sitl.mavlink.places import Origin

NAN = math.nan
ORIGIN = Origin()
UNSET = 2**31 - 1
REPOSITION = mavlink.MAV_CMD_DO_REPOSITION


@pytest.fixture
def flight(fly_mavlink):
    flight = fly_mavlink()
    flight.take_off()
    return flight


def command_int(flight, command, frame, parameters, x, y, z):
    flight.client.received()
    flight.client.send(
        mavlink.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *parameters, x, y, z)
    )
    return [m.result for m in flight.answers("COMMAND_ACK")]


def place_of(flight):
    return flight.autopilot.estimate.position_ned_m


def test_reposition_flies_there_nose_ahead_and_holds(flight):
    north_deg, east_deg = (round(d * 1e7) for d in ORIGIN.degrees((2.0, -1.0, 0.0)))
    frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    go = (-1.0, 1.0, 0.0, NAN)
    assert command_int(flight, REPOSITION, frame, go, north_deg, east_deg, 1.5) == [Ack.ACCEPTED]
    flight.run(10.0)
    assert place_of(flight) == pytest.approx((2.0, -1.0, -1.5), abs=0.1)
    assert flight.autopilot.status.mode is FlightMode.HOLD
    yaw_rad = flight.autopilot.estimate.yaw_rad
    assert yaw_rad == pytest.approx(math.atan2(-1.0, 2.0), abs=0.2)


def test_reposition_takes_local_places_and_leaves_out_what_is_not_given(flight):
    frame = mavlink.MAV_FRAME_LOCAL_NED
    north_m, east_m, _ = place_of(flight)
    go = (-1.0, 1.0, 0.0, 1.0)
    assert command_int(flight, REPOSITION, frame, go, UNSET, UNSET, -1.2) == [Ack.ACCEPTED]
    flight.run(8.0)
    assert place_of(flight) == pytest.approx((north_m, east_m, -1.2), abs=0.25)
    assert flight.autopilot.estimate.yaw_rad == pytest.approx(1.0, abs=0.05)


def test_reposition_in_degrees_of_a_command_long(flight):
    latitude_deg, longitude_deg = ORIGIN.degrees((3.0, 0.0, 0.0))
    place = (latitude_deg, longitude_deg, ORIGIN.amsl_m + 2.0)
    assert flight.acks(REPOSITION, -1.0, 1.0, 0.0, NAN, *place) == [Ack.ACCEPTED]
    flight.run(10.0)
    # A float carries 52 degrees to 4e-6 degrees: 0.2 m along a meridian, less along a parallel.
    assert place_of(flight) == pytest.approx((3.0, 0.0, -2.0), abs=0.35)


def fastest_m_s(flight, north_m, speed_m_s):
    x = round(north_m * 1e4)
    go = (speed_m_s, 1.0, 0.0, 0.0)
    command_int(flight, REPOSITION, mavlink.MAV_FRAME_LOCAL_NED, go, x, 0, -2.0)
    speeds = []
    for _ in range(60):
        flight.run(0.1)
        speeds.append(math.hypot(*flight.world.truth.velocity_ned_m_s[:2]))
    return max(speeds)


def test_the_speed_is_reposition_s_or_change_speed_s_or_the_parameter_s(flight):
    assert fastest_m_s(flight, 4.0, -1.0) == pytest.approx(1.0, abs=0.1)
    assert fastest_m_s(flight, 0.0, 0.5) == pytest.approx(0.5, abs=0.08)
    change = mavlink.MAV_CMD_DO_CHANGE_SPEED
    assert flight.acks(change, 1.0, 0.7, -1.0) == [Ack.ACCEPTED]
    assert fastest_m_s(flight, 4.0, -1.0) == pytest.approx(0.7, abs=0.08)
    assert flight.acks(change, 1.0, -2.0, -1.0) == [Ack.ACCEPTED]
    assert fastest_m_s(flight, 0.0, -1.0) == pytest.approx(1.0, abs=0.1)


def test_a_new_home_is_told_and_heights_and_the_fence_count_from_it(flight):
    set_home = mavlink.MAV_CMD_DO_SET_HOME
    frame = mavlink.MAV_FRAME_LOCAL_NED
    here = (0.0, 0.0, 0.0, 0.0)
    assert command_int(flight, set_home, frame, here, 30_000, -40_000, -0.5) == [Ack.ACCEPTED]
    latest = {message.get_type(): message for message in flight.run(2.1)}
    home = latest["HOME_POSITION"]
    assert (home.x, home.y, home.z) == pytest.approx((3.0, -4.0, -0.5), abs=0.02)
    assert home.altitude == pytest.approx((ORIGIN.amsl_m + 0.5) * 1e3, abs=1)
    height_mm = -place_of(flight)[2] * 1e3
    assert latest["GLOBAL_POSITION_INT"].relative_alt == pytest.approx(height_mm - 500, abs=60)
    flight.autopilot.set_parameter("GF_MAX_HOR_DIST", 4.0)  # home is 5 m away
    flight.run(0.1)
    assert flight.autopilot.status.failsafe
    assert flight.acks(set_home, 1.0) == [Ack.ACCEPTED]
    flight.run(0.1)
    flight.autopilot.set_mode(FlightMode.HOLD)  # a breach is held until a mode is commanded
    flight.run(0.1)
    assert not flight.autopilot.status.failsafe


def test_a_reboot_brings_the_new_system_id_and_the_first_rates(fly_mavlink):
    flight = fly_mavlink()
    flight.run(3.0)
    flight.autopilot.set_parameter("MAV_SYS_ID", 7)
    flight.autopilot.set_parameter("MAV_COMP_ID", 9)
    flight.acks(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE, -1.0)
    assert {message.get_srcSystem() for message in flight.run(1.0)} == {1}
    assert flight.acks(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == [Ack.ACCEPTED]
    assert not flight.autopilot.status.ready_to_arm
    flight.client.beat()
    messages = flight.run(3.0)
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in messages} == {(7, 9)}
    assert "ATTITUDE" in {message.get_type() for message in messages}
    assert flight.autopilot.status.ready_to_arm
    assert flight.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == []  # to system 1: not here


def test_all_clocks_agree(fly_mavlink):
    flight = fly_mavlink()
    flight.run(1.0)
    for message in flight.each(2.0):
        kind, now_s = message.get_type(), flight.world.time_s
        if kind == "SYSTEM_TIME":
            assert message.time_boot_ms == pytest.approx(now_s * 1e3, abs=1)
        elif kind == "TIMESYNC":
            assert (message.tc1, message.ts1) == (0, pytest.approx(now_s * 1e9, abs=1e6))
        elif kind == "ATTITUDE":
            assert message.time_boot_ms == pytest.approx(now_s * 1e3, abs=21)  # 50 Hz estimates
    flight.client.send(mavlink.MAVLink_timesync_message(0, 1))
    (answer,) = flight.answers("TIMESYNC")
    assert answer.tc1 == pytest.approx(flight.world.time_s * 1e9, abs=1e6)


def test_current_mode_tells_what_is_flown_and_what_was_wanted(flight):
    request = mavlink.MAV_CMD_REQUEST_MESSAGE
    flight.autopilot.set_parameter("COM_FAIL_ACT_T", 0.0)
    flight.autopilot.set_parameter("GF_ACTION", 5)
    flight.autopilot.set_parameter("GF_MAX_VER_DIST", 1.0)
    flight.run(0.5)
    flight.client.command(request, 436)
    (mode,) = flight.answers("CURRENT_MODE")
    assert (mode.custom_mode, mode.intended_custom_mode) == (0x06040000, 0x03040000)
    assert mode.standard_mode == 7


def test_vibration_is_more_in_flight_than_on_the_ground(fly_mavlink):
    flight = fly_mavlink()

    def measured():
        flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 241)
        (answer,) = flight.answers("VIBRATION")
        return answer.vibration_y, answer.vibration_z

    flight.run(2.0)
    at_rest = measured()
    flight.take_off()
    assert all(flying > resting > 0.0 for flying, resting in zip(measured(), at_rest, strict=True))


def test_the_camera_is_found(fly_mavlink, camera_description):
    flight = fly_mavlink(camera=camera_description)
    flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 259)
    (camera,) = flight.answers("CAMERA_INFORMATION")
    assert (camera.resolution_h, camera.resolution_v) == (128, 96)
    assert bytes(camera.model_name).rstrip(b"\0") == b"stereo pair, baseline 60 mm"
    flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 269)
    (stream,) = flight.answers("VIDEO_STREAM_INFORMATION")
    assert (stream.uri, stream.framerate) == ("tcp://127.0.0.1:14590", 10.0)
    assert stream.hfov == round(math.degrees(2 * math.atan(0.64)))


def test_a_retry_is_accepted_again_and_done_once(flight):
    home = mavlink.MAV_CMD_DO_SET_HOME

    def send(confirmation, down_m=math.nan):
        flight.client.received()
        flight.client.send(
            mavlink.MAVLink_command_long_message(1, 1, home, confirmation, 1.0, *(NAN,) * 5, down_m)
        )
        return [m.result for m in flight.answers("COMMAND_ACK")]

    assert send(0) == [Ack.ACCEPTED]
    first = flight.autopilot.status.home_ned_m
    flight.run(1.0)
    assert send(1) == send(2) == [Ack.ACCEPTED]
    assert flight.autopilot.status.home_ned_m == first
    assert send(0) == [Ack.ACCEPTED]  # asked for anew
    assert flight.autopilot.status.home_ned_m != first
    again = flight.autopilot.status.home_ned_m
    flight.run(6.0)
    assert send(1) == [Ack.ACCEPTED]  # of nothing that is remembered
    assert flight.autopilot.status.home_ned_m != again


def test_a_retry_of_what_was_refused_is_tried_again(fly_mavlink):
    flight = fly_mavlink()
    arm = mavlink.MAVLink_command_long_message(1, 1, 400, 1, 1.0, *(NAN,) * 6)
    flight.client.send(arm)
    assert [m.result for m in flight.answers("COMMAND_ACK")] == [Ack.TEMPORARILY_REJECTED]
    flight.run(3.0)
    flight.client.send(arm)
    assert [m.result for m in flight.answers("COMMAND_ACK")] == [Ack.ACCEPTED]


def test_flight_termination_stops_the_motors(flight):
    assert flight.acks(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 0.0) == [Ack.ACCEPTED]
    assert flight.autopilot.status.armed
    assert flight.acks(mavlink.MAV_CMD_DO_FLIGHTTERMINATION, 1.0) == [Ack.ACCEPTED]
    assert not flight.autopilot.status.armed
