"""PX4 v1.17's rates and answers as a table: what was measured there, and what this vehicle does.

``python -m pytest tests/sitl/px4 --px4-table FILE`` writes what was measured, here and elsewhere.
"""

import math
from collections import defaultdict

import pytest
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.dialects.v20 import development

from sitl.autopilot.interface import Ack

LONGEST_S = 40.0
RATES_HZ = {
    "ATTITUDE": 100,
    "GLOBAL_POSITION_INT": 50,
    "HIGHRES_IMU": 50,
    "ATTITUDE_QUATERNION": 50,
    "LOCAL_POSITION_NED": 30,
    "ODOMETRY": 30,
    "TIMESYNC": 10,
    "ALTITUDE": 10,
    "DISTANCE_SENSOR": 10,
    "VFR_HUD": 10,
    "ATTITUDE_TARGET": 10,
    "POSITION_TARGET_LOCAL_NED": 10,
    "SERVO_OUTPUT_RAW": 10,
    "GPS_RAW_INT": 8,
    "SYS_STATUS": 5,
    "EXTENDED_SYS_STATE": 5,
    "HEARTBEAT": 1,
    "PING": 1,
    "SYSTEM_TIME": 1,
    "ESTIMATOR_STATUS": 1,
    "MISSION_CURRENT": 1,
    "SCALED_PRESSURE": 1,
    "HOME_POSITION": 0.5,
    "BATTERY_STATUS": 0.5,
    "CURRENT_MODE": 0.5,
    "VIBRATION": 0.5,
}
"""On the onboard link."""


def message_number(name):
    return getattr(development, f"MAVLINK_MSG_ID_{name}")


def rate_hz(times_s):
    return (len(times_s) - 1) / (times_s[-1] - times_s[0])


@pytest.fixture(scope="module")
def heard_s(make_module_flight):
    """Simulated times at which messages came in 40 s, by name, after the first second."""
    flight, times_s = make_module_flight(), defaultdict(list)
    flight.run(1.0)
    for message in flight.each(LONGEST_S):
        times_s[message.get_type()].append(flight.world.time_s)
    return times_s


@pytest.mark.parametrize("name", RATES_HZ)
def test_each_stream_has_its_rate_within_five_percent(heard_s, name, px4_row):
    measured_hz = rate_hz(heard_s[name])
    px4_row("Rates", name, f"{RATES_HZ[name]:g} Hz", f"{measured_hz:.2f} Hz")
    assert measured_hz == pytest.approx(RATES_HZ[name], rel=0.05)


def test_no_stream_is_left_out(heard_s):
    sensed_here_only = {"OPTICAL_FLOW_RAD"}  # PX4's own simulation has no such sensor
    assert set(heard_s) == set(RATES_HZ) | sensed_here_only


@pytest.mark.parametrize("name", RATES_HZ)
@pytest.mark.parametrize("asked_hz", [2.0, 25.0])
def test_each_stream_takes_the_rate_it_is_asked_for(make_module_flight, name, asked_hz, px4_row):
    flight = make_module_flight()
    number = message_number(name)
    ask = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    assert flight.acks(ask, number, 1e6 / asked_hz) == [Ack.ACCEPTED]
    assert flight.interval_us(number) == pytest.approx(1e6 / asked_hz, abs=1)
    times_s = [flight.world.time_s for message in flight.each(4.0) if message.get_type() == name]
    measured_hz = rate_hz(times_s)
    px4_row("Rates asked for", name, f"{asked_hz:g} Hz", f"{measured_hz:.2f} Hz")
    assert measured_hz == pytest.approx(asked_hz, rel=0.05)
    assert flight.acks(ask, number, -1.0) == [Ack.ACCEPTED]
    assert flight.interval_us(number) == -1
    assert flight.acks(ask, number, 0.0) == [Ack.ACCEPTED]
    assert flight.interval_us(number) == pytest.approx(1e6 / RATES_HZ[name], abs=1)


@pytest.mark.parametrize("name", [*RATES_HZ, "AUTOPILOT_VERSION", "VIDEO_STREAM_STATUS"])
def test_each_message_can_be_requested(make_module_flight, name):
    flight = make_module_flight()
    flight.client.received()
    flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, message_number(name))
    flight.server.poll()
    ack, *answers = flight.client.received()
    assert (ack.get_type(), ack.result) == ("COMMAND_ACK", Ack.ACCEPTED)
    assert [answer.get_type() for answer in answers] == [name]


OK, NOT_NOW = [Ack.ACCEPTED], [Ack.TEMPORARILY_REJECTED]
DENIED, UNKNOWN = [Ack.DENIED], [Ack.UNSUPPORTED]
NAN = math.nan
OFFBOARD, HOLD, NO_MODE = (129.0, 6.0, 0.0), (129.0, 4.0, 3.0), (129.0, 9.0, 9.0)
FORCE = 21196.0

ON_THE_GROUND = [
    # command, its parameters, ACKs
    ("COMPONENT_ARM_DISARM", (7.0,), DENIED),
    ("COMPONENT_ARM_DISARM", (0.0,), OK),
    ("NAV_LAND", (), OK),
    ("DO_SET_MODE", HOLD, OK * 2),
    ("DO_SET_MODE", NO_MODE, OK + DENIED),
    ("DO_SET_MODE", (128.0, 4.0, 3.0), OK + DENIED),
    ("DO_SET_MODE", (NAN, NAN, NAN), OK + DENIED),
    ("DO_SET_MODE", OFFBOARD, OK * 2),
    ("COMPONENT_ARM_DISARM", (1.0,), NOT_NOW),  # in offboard without setpoints
    ("DO_SET_MODE", HOLD, OK * 2),
    ("DO_REPOSITION", (-1.0, 1.0, 0.0, NAN, NAN, NAN, NAN), NOT_NOW),
    ("DO_CHANGE_SPEED", (1.0, 0.8, -1.0), OK),
    ("DO_CHANGE_SPEED", (1.0, -2.0, -1.0), OK),
    ("DO_CHANGE_SPEED", (2.0, 0.8, -1.0), DENIED),
    ("DO_CHANGE_SPEED", (1.0, NAN, -1.0), DENIED),
    ("DO_SET_HOME", (1.0,), OK),
    ("DO_SET_HOME", (0.0, 0.0, 0.0, 0.0, NAN, NAN, NAN), DENIED),
    ("DO_SET_HOME", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), DENIED),  # off the coast of Africa
    ("DO_SET_ACTUATOR", (0.5,), DENIED),
    ("PREFLIGHT_STORAGE", (1.0,), DENIED),  # no file to save to
    ("PREFLIGHT_STORAGE", (2.0,), OK),
    ("PREFLIGHT_REBOOT_SHUTDOWN", (0.0,), OK),
    ("PREFLIGHT_REBOOT_SHUTDOWN", (2.0,), DENIED),
    ("SET_MESSAGE_INTERVAL", (9999.0, 1e5), DENIED),
    ("SET_MESSAGE_INTERVAL", (NAN, NAN), DENIED),
    ("SET_MESSAGE_INTERVAL", (30.0, NAN), DENIED),
    ("GET_MESSAGE_INTERVAL", (30.0,), OK),
    ("GET_MESSAGE_INTERVAL", (NAN,), DENIED),
    ("REQUEST_MESSAGE", (9999.0,), DENIED),
    ("REQUEST_MESSAGE", (NAN,), DENIED),
    ("REQUEST_AUTOPILOT_CAPABILITIES", (1.0,), OK),
    ("REQUEST_CAMERA_INFORMATION", (1.0,), OK),
    ("REQUEST_VIDEO_STREAM_INFORMATION", (1.0,), OK),
    ("GET_HOME_POSITION", (), OK),
    ("DO_DIGICAM_CONTROL", (), UNKNOWN),
    ("DO_PARACHUTE", (1.0,), UNKNOWN),
    ("COMPONENT_ARM_DISARM", (1.0,), OK),
    ("COMPONENT_ARM_DISARM", (1.0,), OK),  # again: armed it is
    ("PREFLIGHT_REBOOT_SHUTDOWN", (1.0,), NOT_NOW),
    ("COMPONENT_ARM_DISARM", (0.0,), OK),
    ("COMPONENT_ARM_DISARM", (0.0,), OK),
    ("PREFLIGHT_REBOOT_SHUTDOWN", (1.0,), OK),
    ("COMPONENT_ARM_DISARM", (1.0,), NOT_NOW),  # the estimator settles again
    ("COMPONENT_ARM_DISARM", (1.0, FORCE), OK),
    ("COMPONENT_ARM_DISARM", (0.0, FORCE), OK),
]
IN_THE_AIR = [
    ("NAV_TAKEOFF", (), NOT_NOW),
    ("COMPONENT_ARM_DISARM", (0.0,), NOT_NOW),
    ("DO_SET_MODE", OFFBOARD, OK + NOT_NOW),  # without setpoints
    ("DO_REPOSITION", (-1.0, 1.0, 0.0, NAN, NAN, NAN, NAN), OK),
    ("DO_REPOSITION", (-1.0, 0.0, 0.0, NAN, NAN, NAN, NAN), OK),  # it holds already
    ("DO_REPOSITION", (-1.0, 1.0, 0.0, math.inf, NAN, NAN, NAN), DENIED),
    ("DO_REPOSITION", (-1.0, 1.0, 0.0, NAN, 0.0, 0.0, 1e9), DENIED),
    ("DO_CHANGE_SPEED", (1.0, 0.8, -1.0), OK),
    ("PREFLIGHT_REBOOT_SHUTDOWN", (1.0,), NOT_NOW),
    ("NAV_LOITER_UNLIM", (), OK),
    ("NAV_LAND", (), OK),
    ("DO_REPOSITION", (-1.0, 0.0, 0.0, NAN, NAN, NAN, NAN), DENIED),  # not from landing
    ("NAV_LAND", (), OK),
    ("COMPONENT_ARM_DISARM", (0.0, FORCE), OK),
]


def is_answered_as_listed(flight, table, px4_row, place):
    for name, parameters, wanted in table:
        number = getattr(mavlink, f"MAV_CMD_{name}")
        acks = flight.acks(number, *parameters)
        words = [f"{name} {' '.join(f'{p:g}' for p in parameters)}".strip(), place]
        px4_row("Answers", *words, ", then ".join(ack.name for ack in acks))
        assert acks == wanted, (name, parameters)
        flight.run(0.02)


def test_every_command_on_the_ground_has_its_ack(fly_mavlink, camera_description, px4_row):
    flight = fly_mavlink(camera=camera_description)
    arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert flight.acks(arm, 1.0) == NOT_NOW  # the estimator is not ready
    flight.run(3.0)
    is_answered_as_listed(flight, ON_THE_GROUND, px4_row, "on the ground")


def test_every_command_in_the_air_has_its_ack(fly_mavlink, px4_row):
    flight = fly_mavlink()
    flight.take_off()
    is_answered_as_listed(flight, IN_THE_AIR, px4_row, "in the air")
    assert not flight.autopilot.status.armed


def test_a_repeated_take_off_is_accepted_again_and_changes_nothing(fly_mavlink):
    flight = fly_mavlink()
    flight.run(3.0)
    flight.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    for _ in range(8):
        assert flight.acks(mavlink.MAV_CMD_NAV_TAKEOFF) == OK
        flight.run(0.5)
    flight.run(8.0)
    assert flight.autopilot.airborne
    assert -flight.autopilot.estimate.position_ned_m[2] == pytest.approx(2.5, abs=0.1)


def test_without_a_camera_there_is_nothing_to_tell_about_one(fly_mavlink):
    assert fly_mavlink().acks(mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION, 1.0) == DENIED
