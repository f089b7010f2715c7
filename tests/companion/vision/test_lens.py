"""Rays and pixels of one eye."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import Telemetry
from companion.vision.lens import Lens, grid_of, levelled

EYE = Intrinsics(110.0, 108.0, 63.0, 49.0, (-0.2, 0.05, 0.001, -0.002))


@given(x=st.floats(5.0, 123.0), y=st.floats(5.0, 91.0), depth_m=st.floats(0.1, 50.0))
def test_a_ray_leads_back_to_its_pixel_at_any_depth(x, y, depth_m):
    lens = Lens(EYE)
    point = np.array([[[x, y]]], np.float32)
    assert lens.project(depth_m * lens.rays_of(point)) == pytest.approx(point, abs=0.02)


def test_what_lies_ahead_right_and_below_is_seen_so():
    lens = Lens(EYE)
    level = Telemetry(roll_rad=0.0, pitch_rad=0.0, yaw_rad=np.pi / 2)
    ahead_right_below_ned = np.array([-0.5, 2.0, 0.3])  # looking east
    seen = lens.cam_from_ned(level) @ ahead_right_below_ned
    assert seen == pytest.approx((0.5, 0.3, 2.0))


def test_an_eye_that_is_turned_on_its_mount_knows_it():
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    calibration = StereoCalibration(128, 96, EYE, EYE, 0.06, tuple(turn.reshape(-1)))
    level = Telemetry(roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0)
    left, right = (Lens.of(calibration, eye).cam_from_ned(level) for eye in ("left", "right"))
    assert right == pytest.approx(turn @ left)


def test_a_grid_covers_the_image_but_for_its_margin():
    points = grid_of(20, 12, 4, 4).reshape(-1, 2)
    assert points.tolist() == [[4, 4], [8, 4], [12, 4]]  # row by row


@given(st.integers(1, 200))
def test_images_are_brought_to_one_mean(grey):
    assert levelled(np.full((4, 4), grey, np.uint8)).mean() == pytest.approx(110.0, abs=1.0)
