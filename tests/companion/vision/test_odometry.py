"""What the stereo camera sees of the vehicle's motion, against planted errors of its estimate."""

import itertools
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.kernel.frames import matrix_from_euler
from companion.kernel.messages import Telemetry
from companion.vision.odometry import Odometry
from companion.vision.stereo import StereoMatcher, StereoSettings
from sitl.arena.camera import CameraSettings, StereoCameraModel
from sitl.arena.room import load_room

ROOMS = Path(__file__).parents[3] / "flightplans" / "rooms"
RATE_HZ, FRAMES = 10.0, 20
MOUNT_M = 0.1
SIZE_PX = 128, 96
LENS = (-0.25, 0.08, 0.001, -0.001)


def camera(**settings):
    settings = {"mount_frd_m": (MOUNT_M, 0.0, 0.0)} | settings
    return StereoCameraModel(
        load_room(ROOMS / "room1.toml"), CameraSettings(**settings), np.random.default_rng(0)
    )


def excesses(
    model,
    *,
    velocity=(0.0, 0.0),
    told_too_much=(0.0, 0.0),
    turn_rad_s=0.0,
    sway=0.0,
    told=None,
    older_s=lambda time_s: 0.0,
):
    """What is measured in 2 s of flight in room 1; ``told``: more fields of every telemetry, which
    its stamp says is ``older_s`` older than the frame."""
    matcher = StereoMatcher(StereoSettings(), model.calibration)
    left_eye_m = MOUNT_M, -model.calibration.baseline_m / 2.0, 0.0
    odometry = Odometry(matcher.lens, SIZE_PX, matcher.disparity_metre_px, left_eye_m)
    found = []
    for number in range(FRAMES):
        time_s = number / RATE_HZ
        place = np.array([-0.5, 0.0, -1.2]) + np.array([*velocity, 0.0]) * time_s
        tilt = sway * np.sin(2.0 * time_s + np.arange(2.0))
        yaw_rad = turn_rad_s * time_s
        frame = model.render(tuple(place), matrix_from_euler(*tilt, yaw_rad), round(time_s * 1e9))
        matcher.match(frame.left, frame.right)
        level = np.add(velocity, told_too_much)
        fields = {
            "stamp_ns": frame.stamp_ns - round(older_s(time_s) * 1e9),
            "velocity_ned_m_s": (*level, 0.0), "roll_rad": tilt[0], "pitch_rad": tilt[1],
            "yaw_rad": yaw_rad,
        } | (told or {})  # fmt: skip
        found.append(odometry.observe(matcher.last_matches(), frame.stamp_ns, Telemetry(**fields)))
    return [motion.told_ned_m_s - motion.seen_ned_m_s for motion in found if motion is not None]


@pytest.mark.parametrize(
    "flight",
    [
        {},
        {"velocity": (0.5, 0.0)},
        {"velocity": (0.0, 0.3)},
        {"velocity": (0.3, 0.0), "sway": 0.03},
        {"turn_rad_s": math.radians(45.0)},
    ],
    ids=["hovering", "ahead", "sideways", "swaying", "turning"],
)
@pytest.mark.parametrize("planted", [(0.0, 0.0), (0.2, 0.0), (-0.1, 0.15)])
def test_a_planted_error_of_the_velocity_is_found(flight, planted):
    found = excesses(camera(), told_too_much=planted, **flight)
    assert len(found) >= 8
    assert np.median(found, axis=0)[:2] == pytest.approx(planted, abs=0.03)


def test_two_lenses_that_bend_lines_differently_are_reckoned_with():
    model = camera(left_distortion=LENS, right_distortion=(0.0, 0.0, 0.0, 0.0))
    found = excesses(model, velocity=(0.5, 0.0), told_too_much=(0.2, 0.0))
    assert np.median(found, axis=0)[:2] == pytest.approx((0.2, 0.0), abs=0.03)


def test_an_eye_ahead_of_the_centre_moves_when_the_vehicle_turns():
    """Were that forgotten, turning would seem to be a drift by lever times rate."""
    rate_rad_s = math.radians(45.0)
    found = np.array(excesses(camera(mount_frd_m=(0.3, 0.0, 0.0)), turn_rad_s=rate_rad_s))
    speed_m_s = np.hypot(found[:, 0], found[:, 1])
    assert np.median(speed_m_s) == pytest.approx((0.3 - MOUNT_M) * rate_rad_s, abs=0.03)


@pytest.mark.parametrize(
    "unknown", [{"velocity_ned_m_s": (math.nan,) * 3}, {"roll_rad": math.nan}], ids=str
)
def test_nothing_is_said_without_the_autopilots_estimate(unknown):
    assert excesses(camera(), told=unknown) == []


@pytest.mark.parametrize("older_s", [-7.0, 0.0, 0.3])
def test_clocks_may_be_apart(older_s):
    jitter_s = itertools.cycle([0.0, 0.03, -0.02])
    there = excesses(camera(), older_s=lambda time_s: older_s + next(jitter_s))
    assert len(there) == len(excesses(camera())) > 5


@pytest.mark.parametrize("older_s", [-0.3, 0.3])
def test_telemetry_of_another_moment_than_the_image_says_nothing(older_s):
    """As a link's latency that comes in flight, or frames that come late."""
    found = excesses(camera(), older_s=lambda time_s: older_s if time_s > 1.0 else 0.0)
    np.testing.assert_array_equal(found, excesses(camera())[:5])


def test_a_wall_without_texture_says_nothing():
    model = camera()
    matcher = StereoMatcher(StereoSettings(), model.calibration)
    odometry = Odometry(matcher.lens, SIZE_PX, matcher.disparity_metre_px, (0.0, 0.0, 0.0))
    plain = np.full((model.calibration.height_px, model.calibration.width_px), 90, np.uint8)
    still = Telemetry(velocity_ned_m_s=(0.0,) * 3, roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0)
    matcher.match(plain, plain)
    for stamp_ns in range(0, FRAMES * 10**8, 10**8):
        told = msgspec.structs.replace(still, stamp_ns=stamp_ns)
        assert odometry.observe(matcher.last_matches(), stamp_ns, told) is None


def test_time_that_runs_backwards_begins_anew():
    model = camera()
    matcher = StereoMatcher(StereoSettings(), model.calibration)
    odometry = Odometry(matcher.lens, SIZE_PX, matcher.disparity_metre_px, (MOUNT_M, 0.0, 0.0))
    still = Telemetry(velocity_ned_m_s=(0.0,) * 3, roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0)
    frame = model.render((-0.5, 0.0, -1.2), np.eye(3), 0)
    matcher.match(frame.left, frame.right)
    found = []
    for stamp_ns in (5_000_000_000, 5_200_000_000, 1_000_000_000, 1_200_000_000, 1_400_000_000):
        told = msgspec.structs.replace(still, stamp_ns=stamp_ns)
        found.append(odometry.observe(matcher.last_matches(), stamp_ns, told))
    assert [motion is not None for motion in found] == [False, True, False, False, True]
