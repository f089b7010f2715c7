"""SET_POSITION_TARGET_LOCAL_NED in each frame, as the autopilot gets it."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.interface import Estimate
from sitl.mavlink.setpoints import offboard_setpoint

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
