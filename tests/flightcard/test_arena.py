"""The arena around our own simulator, as if it were another's: both see the same room."""

import numpy as np
import pytest

EXACT = {
    "velocity_bias_m_s": 0,
    "velocity_noise_m_s": 0,
    "height_error_m": 0,
    "attitude_error_deg": 0,
    "yaw_error_deg": 0,
}


@pytest.mark.flight(room="room1", speed=5, sitl={"estimator": EXACT})
def test_the_arena_sees_what_the_vehicles_own_camera_sees(sitl, arena):
    around = arena(pose=sitl.spare_link)
    sitl.take_off(1.2)
    sitl.fly_velocity(2.0, forward_m_s=0.5, yaw_rate_rad_s=0.5)
    own = sitl.next_frame()
    frame = around.next_frame()
    while frame.stamp_ns < own.stamp_ns:
        frame = around.next_frame()
    while own.stamp_ns < frame.stamp_ns:
        own = sitl.next_frame()
    assert own.stamp_ns == frame.stamp_ns
    difference = np.abs(own.left.astype(float) - frame.left).mean()
    sitl.fly_velocity(8.0, forward_m_s=0.5)
    sitl.land()
    truth = {pose.stamp_ns: pose for pose in sitl.path}
    errors_m = [
        np.abs(np.subtract(pose.truth_position_ned_m, truth[pose.stamp_ns].truth_position_ned_m))
        for pose in around.poses()
        if pose.stamp_ns in truth
    ]
    assert len(errors_m) > 100
    assert np.max(errors_m) < 0.03
    assert difference < 6.0
