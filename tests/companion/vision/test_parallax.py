"""Nearness from motion, against the depth that the simulated camera's own rays have."""

import math
from pathlib import Path

import numpy as np
import pytest

from companion.kernel.frames import matrix_from_euler
from companion.kernel.messages import Telemetry
from companion.vision.parallax import Parallax
from sitl.arena.camera import CameraSettings, StereoCameraModel
from sitl.arena.room import load_room

ROOMS = Path(__file__).parents[3] / "flightplans" / "rooms"
RATE_HZ = 10.0
LENS = (-0.25, 0.08, 0.001, -0.001)


def camera(**settings):
    room = load_room(ROOMS / "room1.toml")
    return StereoCameraModel(room, CameraSettings(**settings), np.random.default_rng(0))


def fly(model, eye="left", *, speed_m_s=0.5, course_rad=0.0, turn_rad_s=0.0, told=1.0, sway=0.0):
    """Nearness by frame of 3 s of flight in room 1, and in truth at its end.

    ``told``: what the autopilot says of its speed, over the truth; ``sway``: of its attitude.
    """
    parallax = Parallax(model.calibration, eye)
    velocity = speed_m_s * np.array([np.cos(course_rad), np.sin(course_rad), 0.0])
    found = []
    for number in range(30):
        time_s = number / RATE_HZ
        place = np.array([-1.0, 0.0, -1.2]) + velocity * time_s
        tilt = sway * np.sin(2.0 * time_s + np.arange(2.0))
        yaw_rad = course_rad + turn_rad_s * time_s
        turn = matrix_from_euler(*tilt, yaw_rad)
        frame = model.render(tuple(place), turn, round(time_s * 1e9))
        telemetry = Telemetry(
            velocity_ned_m_s=tuple(told * velocity), roll_rad=tilt[0], pitch_rad=tilt[1],
            yaw_rad=yaw_rad,
        )  # fmt: skip
        image = frame.left if eye == "left" else frame.right
        found.append(parallax.observe(image, frame.stamp_ns, telemetry))
    return np.array(found), float((1.0 / model.depth(tuple(place), turn)).mean())


@pytest.mark.parametrize("eye", ["left", "right"])
def test_what_it_flies_towards_is_as_near_as_it_is(eye):
    found, truth_per_m = fly(camera(), eye)
    assert found[-1] == pytest.approx(truth_per_m, rel=0.08)


def test_what_the_camera_turns_by_is_taken_out():
    found, truth_per_m = fly(camera(), sway=0.03)
    assert found[-1] == pytest.approx(truth_per_m, rel=0.08)


def test_a_lens_that_bends_lines_is_reckoned_with():
    found, truth_per_m = fly(camera(left_distortion=LENS, right_distortion=LENS))
    assert found[-1] == pytest.approx(truth_per_m, rel=0.1)


def test_who_is_told_of_twice_the_speed_finds_all_twice_as_far():
    truly, _ = fly(camera())
    wrongly, _ = fly(camera(), told=2.0)
    assert wrongly[-1] == pytest.approx(truly[-1] / 2.0, rel=0.1)


def test_it_knows_nothing_until_it_has_flown_some_way():
    found, _ = fly(camera())
    assert np.isnan(found[:6]).all()
    assert np.isfinite(found[8:]).all()


def test_who_hovers_or_turns_knows_nothing():
    hovering, _ = fly(camera(), speed_m_s=0.0)
    turning, _ = fly(camera(), turn_rad_s=math.radians(45.0))
    assert np.isnan(hovering).all()
    assert np.isnan(turning).all()


def test_sideways_is_a_way_too():
    model = camera()
    parallax = Parallax(model.calibration, "left")
    for number in range(20):
        place = (0.5, -0.5 + 0.05 * number, -1.2)
        frame = model.render(place, np.eye(3), number * 10**8)
        telemetry = Telemetry(
            velocity_ned_m_s=(0.0, 0.5, 0.0), roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0
        )
        found = parallax.observe(frame.left, frame.stamp_ns, telemetry)
    truth_per_m = float((1.0 / model.depth(place, np.eye(3))).mean())
    assert found == pytest.approx(truth_per_m, rel=0.05)


@pytest.mark.parametrize(
    "lost",
    [
        {"velocity_ned_m_s": (math.nan,) * 3},
        {"roll_rad": math.nan},
        {"yaw_rad": math.nan},
    ],
)
def test_without_the_autopilots_estimate_it_begins_anew(lost):
    model = camera()
    parallax = Parallax(model.calibration, "left")
    known = {"velocity_ned_m_s": (0.5, 0.0, 0.0), "roll_rad": 0.0, "pitch_rad": 0.0, "yaw_rad": 0.0}
    found = []
    for number in range(30):
        frame = model.render((-1.0 + 0.05 * number, 0.0, -1.2), np.eye(3), number * 10**8)
        told = known | (lost if number == 15 else {})
        found.append(parallax.observe(frame.left, frame.stamp_ns, Telemetry(**told)))
    assert np.isfinite(found[14])
    assert np.isnan(found[15:21]).all()
    assert np.isfinite(found[25])


def test_images_without_texture_say_nothing():
    model = camera()
    parallax = Parallax(model.calibration, "left")
    telemetry = Telemetry(
        velocity_ned_m_s=(0.5, 0.0, 0.0), roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0
    )
    blank = np.full((96, 128), 130, np.uint8)
    found = [parallax.observe(blank, number * 10**8, telemetry) for number in range(20)]
    assert np.isnan(found).all()
