"""The arena around our own simulator, as if it were another's: both see the same room."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sitl.cli import main

ROOM = Path(__file__).parents[2] / "flightplans" / "rooms" / "room1.toml"

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
    sitl.fly_velocity(5.0, right_m_s=0.5)
    truth = {pose.stamp_ns: pose for pose in sitl.path}
    errors_m = [
        np.abs(np.subtract(pose.truth_position_ned_m, truth[pose.stamp_ns].truth_position_ned_m))
        for pose in around.poses()
        if pose.stamp_ns in truth
    ]
    assert len(errors_m) > 100
    assert np.max(errors_m) < 0.03
    assert difference < 6.0


def test_without_an_autopilot_it_waits_and_says_what_it_saw():
    command = [sys.executable, "-m", "sitl", "arena", str(ROOM), "--camera", "tcp://127.0.0.1:0"]
    process = subprocess.Popen(
        [*command, "--pose", "udpin://127.0.0.1:0"], stdout=subprocess.PIPE, text=True
    )
    with process:
        assert json.loads(process.stdout.readline())["ready"] is True
        process.send_signal(signal.SIGTERM)
        said = json.loads(process.communicate(timeout=60.0)[0])
    assert process.returncode == 0
    assert said == {
        "frames": 0,
        "frames_skipped": 0,
        "collisions": 0,
        "minimum_clearance_m": None,
        "source": None,
    }


def test_a_wrong_link_is_one_line_and_exit_code_2(capsys):
    assert main(["arena", str(ROOM), "--pose", "nonsense"]) == 2
    out, error = capsys.readouterr()
    assert (out, error.count("\n")) == ("", 1)
    assert "udpin://HOST:PORT" in error
