"""External vision over MAVLink: every message that carries it, and what each is good for."""

import math

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import quaternion_from_euler

NOTHING = [math.nan] * 21


def odometry(frame=mavlink.MAV_FRAME_LOCAL_NED, value=0.0):
    q = quaternion_from_euler(0.0, 0.0, 0.5)  # as it stands in the tests' open air
    return mavlink.MAVLink_odometry_message(
        *(0, frame, mavlink.MAV_FRAME_BODY_FRD, value, 0.0, 0.0, q),
        *(value, 0.0, 0.0, 0.0, 0.0, 0.0, NOTHING, NOTHING),
    )


POSES = {
    "ODOMETRY": odometry(),
    "ODOMETRY as MAVSDK has it": odometry(14),
    "VISION_POSITION_ESTIMATE": mavlink.MAVLink_vision_position_estimate_message(
        0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, NOTHING
    ),
    "ATT_POS_MOCAP": mavlink.MAVLink_att_pos_mocap_message(
        0, quaternion_from_euler(0.0, 0.0, 0.5), 0.0, 0.0, 0.0, NOTHING
    ),
}


def drift_m(flight, message, duration_s=5.0):
    """How far the estimate has walked from home after that many seconds of such messages."""
    for _ in range(round(duration_s * 20)):
        if message is not None:
            flight.client.send(message)
        flight.run(0.05)
    return math.hypot(*flight.autopilot.estimate.position_ned_m[:2])


@pytest.mark.parametrize("name", POSES)
def test_each_message_bounds_the_drift(fly_mavlink, drifting_settings, name):
    flight = fly_mavlink(settings=drifting_settings)
    assert drift_m(flight, POSES[name]) < 0.05
    flight.client.command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS)
    (status,) = flight.answers("ESTIMATOR_STATUS")
    assert status.flags & mavlink.ESTIMATOR_POS_HORIZ_ABS
    assert 0.0 < status.pos_horiz_accuracy < 0.1


@pytest.mark.parametrize(
    "message",
    [None, odometry(mavlink.MAV_FRAME_LOCAL_ENU), odometry(value=math.nan)],
    ids=["nothing", "unknown frame", "nan"],
)
def test_what_cannot_be_used_does_not(fly_mavlink, drifting_settings, message):
    assert drift_m(fly_mavlink(settings=drifting_settings), message) > 0.9


def test_speeds_slow_the_drift_down(fly_mavlink, drifting_settings):
    still = mavlink.MAVLink_vision_speed_estimate_message(0, 0.0, 0.0, 0.0, [math.nan] * 9)
    assert drift_m(fly_mavlink(settings=drifting_settings), still) < 0.5
