"""SET_POSITION_TARGET_LOCAL_NED in each frame, as the autopilot gets it."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import quaternion_from_euler
from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Estimate
from sitl.mavlink.places import Datum, Origin
from sitl.mavlink.setpoints import (
    FRAMES,
    attitude_setpoint,
    global_setpoint,
    manual_input,
    offboard_setpoint,
)

IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_YAW, IGNORE_YAW_RATE = 7, 56, 1024, 2048
POSITION = (1.0, 2.0, -3.0)

angles = st.floats(-3.1, 3.1)
speeds = st.floats(-5.0, 5.0)


def estimate(yaw_rad=0.0, position=(0.0, 0.0, 0.0)):
    still = (0.0, 0.0, 0.0)
    return Estimate(1.0, position, still, 0.1, 0.2, yaw_rad, still, (0.0, 0.0, -9.8))


def target(frame, mask=0, position=POSITION, velocity=(0.0, 0.0, 0.0), yaw=0.0, yaw_rate=0.0):
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, *position, *velocity, 0.0, 0.0, 0.0, yaw, yaw_rate
    )


@given(yaw=angles, forward=speeds, right=speeds, down=speeds)
def test_body_velocity_is_turned_by_yaw_alone(yaw, forward, right, down):
    message = target(mavlink.MAV_FRAME_BODY_NED, velocity=(forward, right, down))
    north, east, got_down = offboard_setpoint(message, estimate(yaw)).velocity_ned_m_s
    assert got_down == down
    assert math.hypot(north, east) == pytest.approx(math.hypot(forward, right))
    assert north * math.cos(yaw) + east * math.sin(yaw) == pytest.approx(forward, abs=1e-9)


def test_masked_parts_are_not_controlled():
    mask = IGNORE_POSITION | IGNORE_YAW
    got = offboard_setpoint(target(mavlink.MAV_FRAME_LOCAL_NED, mask, yaw_rate=0.3), estimate())
    assert all(math.isnan(value) for value in got.position_ned_m)
    assert math.isnan(got.yaw_rad)
    assert (got.velocity_ned_m_s, got.yaw_rate_rad_s) == ((0.0, 0.0, 0.0), 0.3)
    mask = IGNORE_VELOCITY | IGNORE_YAW_RATE
    got = offboard_setpoint(target(mavlink.MAV_FRAME_LOCAL_NED, mask, yaw=0.3), estimate())
    assert (got.position_ned_m, got.yaw_rad) == (POSITION, 0.3)
    assert all(math.isnan(value) for value in (*got.velocity_ned_m_s, got.yaw_rate_rad_s))


@pytest.mark.parametrize(
    ("frame", "height_m"),
    [
        (mavlink.MAV_FRAME_GLOBAL_INT, 13.0),
        (mavlink.MAV_FRAME_GLOBAL, 13.0),
        (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 2.0),
    ],
)
def test_global_places_become_local_ones(frame, height_m):
    origin = Origin()
    latitude, longitude = (round(d * 1e7) for d in origin.degrees(POSITION))
    message = mavlink.MAVLink_set_position_target_global_int_message(
        *(0, 1, 1, frame, IGNORE_VELOCITY | 448 | IGNORE_YAW_RATE, latitude, longitude, height_m),
        *(0.0,) * 6,
        0.3,
        0.0,
    )
    got = global_setpoint(message, Datum(origin, home_down_m=-1.0))
    assert got.position_ned_m == pytest.approx(POSITION, abs=0.01)
    assert got.yaw_rad == 0.3
    assert math.isnan(got.velocity_ned_m_s[0])
    message.coordinate_frame = mavlink.MAV_FRAME_LOCAL_NED
    assert global_setpoint(message, Datum(origin)) is None


def test_one_masked_axis_leaves_the_others():
    got = offboard_setpoint(target(mavlink.MAV_FRAME_LOCAL_NED, 4), estimate())
    assert got.position_ned_m[:2] == POSITION[:2]
    assert math.isnan(got.position_ned_m[2])


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (mavlink.MAV_FRAME_LOCAL_NED, (1.0, 2.0, -3.0)),
        (mavlink.MAV_FRAME_LOCAL_OFFSET_NED, (11.0, 22.0, -8.0)),
        (mavlink.MAV_FRAME_BODY_NED, (8.0, 21.0, -8.0)),
        (mavlink.MAV_FRAME_BODY_OFFSET_NED, (8.0, 21.0, -8.0)),
    ],
)
def test_positions_count_from_home_or_from_the_vehicle(frame, expected):
    here = estimate(math.pi / 2, (10.0, 20.0, -5.0))
    assert offboard_setpoint(target(frame), here).position_ned_m == pytest.approx(expected)


def test_the_yaw_of_body_offset_counts_from_the_heading():
    message = target(mavlink.MAV_FRAME_BODY_OFFSET_NED, yaw=3.0)
    assert offboard_setpoint(message, estimate(1.0)).yaw_rad == pytest.approx(4.0 - 2 * math.pi)


def test_other_frames_are_refused():
    assert offboard_setpoint(target(mavlink.MAV_FRAME_GLOBAL), estimate()) is None


def attitude(mask, q=(1.0, 0.0, 0.0, 0.0), rates=(0.1, 0.2, 0.3), thrust=0.6):
    return attitude_setpoint(
        mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, *rates, thrust)
    )


def test_an_attitude_is_flown_by_its_angles():
    angles = (0.1, -0.2, 1.0)
    setpoint = attitude(1 | 2, quaternion_from_euler(*angles))
    assert setpoint[:3] == pytest.approx(angles)
    assert setpoint.rates_frd_rad_s == pytest.approx((math.nan, math.nan, 0.3), nan_ok=True)
    assert setpoint.thrust_norm == 0.6


@pytest.mark.parametrize(
    ("mask", "q"), [(128, (1.0, 0.0, 0.0, 0.0)), (0, (0.0,) * 4), (0, (math.nan,) * 4)]
)
def test_without_a_usable_attitude_the_rates_are_flown(mask, q):
    setpoint = attitude(mask, q)
    assert all(math.isnan(angle) for angle in setpoint[:3])
    assert setpoint.rates_frd_rad_s == (0.1, 0.2, 0.3)
    assert attitude(mask | 64, q).thrust_norm == 0.0


@pytest.mark.parametrize(
    ("axes", "sticks"),
    [
        ((0, 0, 500, 0), (0.0, 0.0, 0.0, 0.0)),
        ((1000, -1000, 1000, 250), (1.0, -1.0, 1.0, 0.25)),
        ((0x7FFF, 0x7FFF, 0, 0x7FFF), (0.0, 0.0, -1.0, 0.0)),
    ],
)
def test_sticks_are_shares_of_full_deflection(axes, sticks):
    message = mavlink.MAVLink_manual_control_message(1, *axes, 0)
    assert manual_input(message) == sticks


def test_a_body_acceleration_is_turned_to_ned():
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        *(0, 1, 1, mavlink.MAV_FRAME_BODY_NED, 63 | 1024 | 2048),
        *(0.0,) * 6,
        *(1.0, 0.0, -0.5, 0.0, 0.0),
    )
    setpoint = offboard_setpoint(message, estimate(yaw_rad=math.pi / 2))
    assert setpoint.acceleration_ned_m_s2 == pytest.approx((0.0, 1.0, -0.5))
    assert all(math.isnan(speed) for speed in setpoint.velocity_ned_m_s)


any_float = st.floats(width=32)
streams = st.lists(
    st.one_of(
        st.builds(
            mavlink.MAVLink_set_position_target_local_ned_message,
            *(st.just(0), st.just(1), st.just(1), st.sampled_from(sorted(FRAMES))),
            *(st.integers(0, 0xFFFF), *[any_float] * 11),
        ),
        st.builds(
            mavlink.MAVLink_set_attitude_target_message,
            *(st.just(0), st.just(1), st.just(1), st.integers(0, 0xFF)),
            *(st.tuples(*[any_float] * 4), *[any_float] * 4),
        ),
    ),
    min_size=1,
    max_size=5,
)


@settings(max_examples=25)
@given(streams)
def test_no_setpoint_breaks_the_vehicle(make_flight, stream):
    """It may fall, but what it is stays a number."""
    flight = make_flight()
    flight.take_off(1.0)
    for message in stream:
        now = flight.autopilot.estimate
        is_attitude = message.get_type() == "SET_ATTITUDE_TARGET"
        setpoint = attitude_setpoint(message) if is_attitude else offboard_setpoint(message, now)
        flight.autopilot.set_offboard_setpoint(setpoint)
        flight.autopilot.set_mode(FlightMode.OFFBOARD)
        flight.run(0.2)
    assert all(math.isfinite(place) for place in flight.world.truth.position_ned_m)
