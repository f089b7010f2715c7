"""Planted disparities are found again, whatever the camera's geometry."""

import math
from functools import cache

import cv2
import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import CameraError, PlanError
from companion.kernel.settings import convert_settings
from companion.vision.stereo import StereoMatcher, StereoSettings

WIDTH_PX, HEIGHT_PX = 128, 96
EYE = Intrinsics(120.0, 120.0, 64.0, 48.0)
CALIBRATION = StereoCalibration(WIDTH_PX, HEIGHT_PX, EYE, EYE, baseline_m=0.06)


@cache
def texture(seed=0):
    """A wall painted with blots of several sizes: (400, 600), grey levels."""
    rng = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(rng.normal(0, 1, (400, 600)), (0, 0), s) for s in (1.5, 4, 10)]
    wall = sum(layer / layer.std() for layer in layers)
    return np.clip(128 + 30 * wall, 0, 255).astype(np.float32)


def with_noise(image, rng):
    return np.clip(image + rng.normal(0, 1, image.shape), 0, 255).round().astype(np.uint8)


def planted_pair(disparity_px, infinity_px=0.0, seed=0):
    """A pair whose left pixel (row, column) is disparity_px[row, column] further left in the right.

    disparity_px: scalar or (height, width), constant within a row's run; the right image is drawn
    from far to near, as the eye sees it.
    """
    disparity_px = np.broadcast_to(np.asarray(disparity_px, np.float32), (HEIGHT_PX, WIDTH_PX))
    wall, rng = texture(seed), np.random.default_rng(seed)
    rows, columns = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(np.float32)
    left = cv2.remap(wall, columns + 200, rows + 100, cv2.INTER_CUBIC)
    right = np.zeros_like(left)
    for value in np.unique(disparity_px):
        mask_left = np.pad((disparity_px == value).astype(np.float32), ((0, 0), (64, 64)), "edge")
        shift = np.float32(value + infinity_px)
        mask = cv2.remap(mask_left, columns + 64 + shift, rows, cv2.INTER_NEAREST) > 0
        right[mask] = cv2.remap(wall, columns + 200 + shift, rows + 100, cv2.INTER_CUBIC)[mask]
    return with_noise(left, rng), with_noise(right, rng)


@pytest.mark.parametrize("disparity_px", [0.5, 2.0, 4.25, 7.7, 15.0, 26.0])
def test_a_planted_disparity_is_found(disparity_px):
    result = StereoMatcher(StereoSettings(), CALIBRATION).match(*planted_pair(disparity_px))
    assert result.disparity_px == pytest.approx(disparity_px, abs=0.15)
    assert result.valid_norm > 0.6


@pytest.mark.parametrize("infinity_px", [-5.0, 2.0, -3.4])
@pytest.mark.parametrize("disparity_px", [0.0, 3.0, 20.0])
def test_disparity_at_infinity_comes_from_the_principal_points(infinity_px, disparity_px):
    right = msgspec.structs.replace(EYE, centre_x_px=EYE.centre_x_px - infinity_px)
    calibration = msgspec.structs.replace(CALIBRATION, right=right)
    pair = planted_pair(disparity_px, infinity_px)
    result = StereoMatcher(StereoSettings(), calibration).match(*pair)
    assert result.disparity_px == pytest.approx(disparity_px, abs=0.15)


def test_mean_and_quality_do_not_depend_on_the_search_range():
    """A near left half in front of a far right half: what the left border loses would show."""
    disparity_px = np.where(np.arange(WIDTH_PX) < WIDTH_PX // 2, 10.0, 3.0)
    pair = planted_pair(np.tile(disparity_px, (HEIGHT_PX, 1)))
    results = [
        StereoMatcher(StereoSettings(disparities_px=count), CALIBRATION).match(*pair)
        for count in (16, 32, 64, 96)
    ]
    for result in results[1:]:
        assert result.disparity_px == pytest.approx(results[0].disparity_px, abs=0.1)
        assert result.valid_norm == pytest.approx(results[0].valid_norm, abs=0.03)


def test_pixels_at_the_left_border_are_matched_where_the_right_eye_sees_them():
    settings = StereoSettings(disparities_px=64)
    disparity_px = StereoMatcher(settings, CALIBRATION).disparity_map(*planted_pair(2.0))
    seen = ~np.isnan(disparity_px[20:-20])
    assert seen[:, 3:10].mean() > 0.9
    assert not seen[:, :1].any()


def test_map_and_mean_tell_the_same():
    disparity_px = np.tile(np.repeat([3.0, 9.0], WIDTH_PX // 2), (HEIGHT_PX, 1))
    pair = planted_pair(disparity_px)
    matcher = StereoMatcher(StereoSettings(), CALIBRATION)
    found_px, result = matcher.disparity_map(*pair), matcher.match(*pair)
    assert found_px.shape == (HEIGHT_PX, WIDTH_PX)
    assert found_px.dtype == np.float32
    assert np.nanmean(found_px) == pytest.approx(result.mean_px, abs=1e-4)
    assert np.isfinite(found_px).mean() == pytest.approx(result.valid_norm)
    assert np.nanmedian(found_px[:, 20:40]) == pytest.approx(3.0, abs=0.2)
    assert np.nanmedian(found_px[:, 90:110]) == pytest.approx(9.0, abs=0.2)


def test_quantile_label_sees_the_nearest_quarter():
    """A pillar over 40 % of the view: the mean is in between, the top 24 % are all pillar."""
    disparity_px = np.full((HEIGHT_PX, WIDTH_PX), 2.0)
    disparity_px[:, 50:100] = 8.0
    pair = planted_pair(disparity_px)
    mean = StereoMatcher(StereoSettings(), CALIBRATION).match(*pair)
    quantile = StereoMatcher(StereoSettings(), CALIBRATION, label="quantile").match(*pair)
    assert 3.0 < mean.disparity_px < 6.0
    assert quantile.disparity_px == pytest.approx(8.0, abs=0.4)
    assert quantile.mean_px == mean.disparity_px


@pytest.mark.parametrize("share", [0.1, 0.24, 0.5, 0.9])
def test_quantile_is_exceeded_by_its_share_of_the_matches(share):
    ramp = np.tile(np.repeat(np.arange(1.0, 17.0), WIDTH_PX // 16), (HEIGHT_PX, 1))
    pair = planted_pair(ramp[:, ::-1])
    matcher = StereoMatcher(StereoSettings(quantile_norm=share), CALIBRATION)
    found_px, quantile_px = matcher.disparity_map(*pair), matcher.match(*pair).quantile_px
    found_px = found_px[~np.isnan(found_px)]
    assert (found_px > quantile_px).mean() <= share
    assert (found_px >= quantile_px).mean() >= share


def test_a_blank_wall_is_unknown_not_far_away():
    rng = np.random.default_rng(0)
    blank = np.full((HEIGHT_PX, WIDTH_PX), 120.0)
    pair = with_noise(blank, rng), with_noise(blank, rng)
    result = StereoMatcher(StereoSettings(), CALIBRATION).match(*pair)
    assert math.isnan(result.disparity_px)
    assert result.valid_norm < 0.05


def test_brightness_of_one_eye_does_not_matter():
    left, right = planted_pair(5.0)
    darker = np.clip(right * 0.9 - 10.0, 0, 255).astype(np.uint8)
    result = StereoMatcher(StereoSettings(), CALIBRATION).match(left, darker)
    assert result.disparity_px == pytest.approx(5.0, abs=0.2)


def seen_by(eye, cam_from_left, offset_m, depth_m):
    """What an eye sees of a wall at ``depth_m`` before the left eye, parallel to its image."""
    matrix = np.array(
        [[eye.focal_x_px, 0, eye.centre_x_px], [0, eye.focal_y_px, eye.centre_y_px], [0, 0, 1]]
    )
    rows, columns = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(np.float64)
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    flat = cv2.undistortPoints(pixels[:, None], matrix, np.array(eye.distortion)).reshape(-1, 2)
    rays = np.column_stack([flat, np.ones(len(flat))]) @ cam_from_left
    centre_m = cam_from_left.T @ offset_m
    points_m = centre_m + rays * ((depth_m - centre_m[2]) / rays[:, 2])[:, None]
    place = (points_m[:, :2] / depth_m * 120.0).reshape(HEIGHT_PX, WIDTH_PX, 2)
    x = (place[..., 0] + 300).astype(np.float32)
    y = (place[..., 1] + 200).astype(np.float32)
    return cv2.remap(texture(), x, y, cv2.INTER_CUBIC)


@pytest.mark.parametrize("depth_m", [0.5, 1.0, 3.0])
@pytest.mark.parametrize(
    ("turn_rad", "distortion", "focal_right_px", "row_offset_px"),
    [
        ((0.0, 0.03, 0.0), (0.0, 0.0, 0.0, 0.0), 120.0, 0.0),
        ((0.01, -0.02, 0.015), (-0.2, 0.05, 0.001, -0.001), 124.0, 2.5),
    ],
)
def test_rectification_undoes_rotation_distortion_and_unequal_eyes(
    depth_m, turn_rad, distortion, focal_right_px, row_offset_px
):
    right_from_left, _ = cv2.Rodrigues(np.array(turn_rad))
    left = msgspec.structs.replace(EYE, distortion=distortion)
    right = Intrinsics(focal_right_px, focal_right_px, 62.0, 48.0 + row_offset_px, distortion)
    calibration = StereoCalibration(
        WIDTH_PX, HEIGHT_PX, left, right, 0.06, tuple(right_from_left.ravel())
    )
    rng = np.random.default_rng(1)
    baseline_m = np.array([0.06, 0.0, 0.0])
    pair = (
        with_noise(seen_by(left, np.eye(3), np.zeros(3), depth_m), rng),
        with_noise(seen_by(right, right_from_left, baseline_m, depth_m), rng),
    )
    matcher = StereoMatcher(StereoSettings(), calibration)
    result = matcher.match(*pair)
    # The rectified view is turned against the wall: its mean 1/depth is off by a few per cent.
    expected_px = matcher.disparity_metre_px / depth_m
    assert result.disparity_px == pytest.approx(expected_px, rel=0.05, abs=0.15)
    assert result.valid_norm > 0.5


def test_same_pair_same_result():
    pair = planted_pair(4.0)
    first = StereoMatcher(StereoSettings(), CALIBRATION)
    assert first.match(*pair) == first.match(*pair)
    other = StereoMatcher(StereoSettings(), CALIBRATION)
    assert_allclose(first.disparity_map(*pair), other.disparity_map(*pair), atol=0.0)


@pytest.mark.parametrize("shape", [(96, 64), (48, 128), (96, 128, 3)])
def test_an_image_of_another_size_names_both_sizes(shape):
    left, _ = planted_pair(4.0)
    matcher = StereoMatcher(StereoSettings(), CALIBRATION)
    with pytest.raises(CameraError, match=r"right image .* declares uint8 of shape \(96, 128\)"):
        matcher.match(left, np.zeros(shape, np.uint8))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"block_px": 10}, "block_px must be odd, got 10"),
        ({"disparities_px": 20}, "disparities_px: .*multiple of 16"),
        ({"min_valid_norm": 2.0}, "min_valid_norm"),
    ],
)
def test_impossible_settings_are_refused(table, message):
    with pytest.raises(PlanError, match=message):
        convert_settings(table, StereoSettings, "plan.toml")


def test_a_block_larger_than_the_image_is_refused():
    small = msgspec.structs.replace(CALIBRATION, width_px=32, height_px=24)
    with pytest.raises(PlanError, match=r"stereo.block_px: 25 .* allowed: below 24"):
        StereoMatcher(StereoSettings(block_px=25), small)


def test_the_last_map_is_that_of_the_pair_just_matched():
    matcher = StereoMatcher(StereoSettings(), CALIBRATION)
    with pytest.raises(RuntimeError, match="needs a pair"):
        matcher.last_map()
    for disparity_px in (3.0, 6.0):
        pair = planted_pair(disparity_px)
        matcher.match(*pair)
        assert_allclose(matcher.last_map(), matcher.disparity_map(*pair), atol=0.0)
