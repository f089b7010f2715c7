"""The stereo camera: disparity, noise, exposure and faults that can be measured again."""

import math
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from companion.kernel.errors import PlanError, SimulatorError
from companion.kernel.frames import matrix_from_euler
from companion.kernel.settings import convert_settings
from sitl.arena.camera import CameraSettings, StereoCameraModel, mean_disparity_px
from sitl.arena.room import build_room, load_room

ROOMS = Path(__file__).parents[2] / "flightplans" / "rooms"
NORTH = matrix_from_euler(0.0, 0.0, 0.0)
QUIET = CameraSettings(
    mount_frd_m=(0.0, 0.0, 0.0), read_noise_lsb=0.0, shot_noise_white_lsb=0.0, vignetting_norm=0.0
)


def model_of(room, settings=QUIET, seed=1, **changes):
    chosen = msgspec.structs.replace(settings, **changes)
    return StereoCameraModel(room, chosen, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def room():
    return load_room(ROOMS / "room2.toml")


@pytest.fixture(scope="module")
def small():
    """A bare room, painted in no time."""
    bare = load_room(ROOMS / "room2.toml").settings
    return build_room(msgspec.structs.replace(bare, texel_m=0.02, poster=()), ROOMS / "x.toml")


@pytest.fixture(scope="module")
def quiet(room):
    return model_of(room)


def shift_px(one, other, guess_px=(0.0, 0.0)):
    """(columns, rows) by which the middle of ``one`` lies to the right of and below ``other``."""
    warp = np.array([[1.0, 0.0, -guess_px[0]], [0.0, 1.0, -guess_px[1]]], np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-6)
    middle = np.zeros_like(one)
    middle[28:-28, 28:-28] = 255
    _, warp = cv2.findTransformECC(
        one, other, warp, cv2.MOTION_TRANSLATION, criteria, inputMask=middle, gaussFiltSize=1
    )
    return -warp[0, 2], -warp[1, 2]


@pytest.mark.parametrize("distance_m", [0.8, 1.0, 1.7, 2.5, 4.0])
def test_disparity_is_focal_length_times_baseline_over_depth(quiet, distance_m):
    frame = quiet.render((2.5 - distance_m, 0.1, -1.5), NORTH, 0)
    expected_px = quiet.calibration.disparity_metre_px / distance_m
    columns, rows = shift_px(frame.left, frame.right, (round(expected_px), 0.0))

    assert columns == pytest.approx(expected_px, abs=0.1)
    assert rows == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("name", ["room1", "room2", "office"])
def test_block_matching_finds_walls_in_shipped_rooms(name):
    room = load_room(ROOMS / f"{name}.toml")
    model = model_of(room, CameraSettings())
    matcher = cv2.StereoBM.create(16, 9)
    half_m = room.settings.size_m[0] / 2
    for yaw_deg in (0, 90, 180, 270):
        yaw_rad = math.radians(yaw_deg)
        for distance_m in (0.8, 1.5, 4.0):
            along_m = half_m - distance_m - 0.1
            place = (along_m * math.cos(yaw_rad), along_m * math.sin(yaw_rad), -1.4)
            pose = (place, matrix_from_euler(0.0, 0.0, yaw_rad))
            frame = model.render(*pose, 0)
            disparity_px = matcher.compute(frame.left, frame.right) / 16.0
            truth_px = model.calibration.disparity_metre_px / model.depth(*pose)
            valid = disparity_px >= 0.0
            assert valid.mean() > 0.6, (yaw_deg, distance_m)
            error_px = np.abs(disparity_px - truth_px)[valid]
            assert np.median(error_px) < 0.15, (yaw_deg, distance_m)


def test_calibration_states_the_papers_camera(quiet):
    calibration = quiet.calibration

    assert (calibration.width_px, calibration.height_px) == (128, 96)
    assert calibration.baseline_m == 0.06
    fov_rad = 2 * math.atan(64 / calibration.left.focal_x_px)
    assert math.degrees(fov_rad) == pytest.approx(57.4)


def test_same_seed_gives_the_same_bytes(small):
    def flight():
        model = model_of(small, CameraSettings())
        poses = [((0.1 * k, 0.0, -1.5), matrix_from_euler(0.0, 0.0, 0.3 * k)) for k in range(4)]
        frames = [model.render(*pose, k) for k, pose in enumerate(poses)]
        return b"".join(frame.left.tobytes() + frame.right.tobytes() for frame in frames)

    assert flight() == flight()


def test_frame_carries_its_stamp_and_two_grey_images(quiet):
    frame = quiet.render((0.0, 0.0, -1.5), NORTH, 12_345)

    assert frame.stamp_ns == 12_345
    for image in (frame.left, frame.right):
        assert image.dtype == np.uint8
        assert image.shape == (96, 128)


def test_noise_has_the_deviation_that_was_asked_for(small):
    noisy = model_of(small, read_noise_lsb=2.0, shot_noise_white_lsb=3.0)
    frames = [noisy.render((0.0, 0.0, -1.5), NORTH, k) for k in range(40)]
    stack = np.stack([frame.left for frame in frames]).astype(float)

    grey, deviation = stack.mean(axis=0), stack.std(axis=0)
    expected = np.sqrt(2.0**2 + 3.0**2 * grey / 255 + 1 / 12)
    assert (deviation / expected).mean() == pytest.approx(1.0, abs=0.03)
    left, right = (np.stack([getattr(f, eye) for f in frames]) for eye in ("left", "right"))
    noise = [eye - eye.mean(axis=0) for eye in (left, right)]
    assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.02


def test_exposure_follows_a_change_of_light_over_some_frames(small):
    dark = msgspec.structs.replace(small.settings.surface.east, illumination=0.3)
    surface = msgspec.structs.replace(small.settings.surface, east=dark)
    room = build_room(msgspec.structs.replace(small.settings, surface=surface), ROOMS / "x.toml")
    model = model_of(room)
    model.render((0.0, 0.0, -1.5), NORTH, 0)
    east = matrix_from_euler(0.0, 0.0, math.pi / 2)
    means = [model.render((0.9, 0.9, -1.5), east, k).left.mean() for k in range(25)]

    assert means[0] < 70.0
    assert (np.diff(means) > -1.0).all()
    assert means[-1] == pytest.approx(130.0, abs=3.0)


def test_corners_lose_the_light_they_are_said_to(small):
    plain, shaded = model_of(small), model_of(small, vignetting_norm=0.4)
    pose = ((0.0, 0.0, -1.5), NORTH)
    ratio = shaded.render(*pose, 0).left / np.maximum(plain.render(*pose, 0).left, 1.0)
    middle, corner = ratio[44:52, 60:68].mean(), ratio[:4, :4].mean()

    assert corner / middle == pytest.approx(1.0 - 0.4, abs=0.05)


def test_undeclared_faults_of_the_right_eye_shift_its_image(room):
    pose = ((0.0, 0.1, -1.5), NORTH)
    quiet = model_of(room)
    sound = quiet.render(*pose, 0)
    tilted = model_of(room, misalignment_deg=(0.5, 0.0, 0.0))
    offset = model_of(room, centre_error_px=(1.5, -0.5))

    assert tilted.calibration == offset.calibration == quiet.calibration
    np.testing.assert_array_equal(tilted.render(*pose, 0).left, sound.left)
    focal_px = quiet.calibration.left.focal_x_px
    rows = shift_px(tilted.render(*pose, 0).right, sound.right)[1]
    assert abs(rows) == pytest.approx(focal_px * math.radians(0.5), abs=0.15)
    columns, rows = shift_px(offset.render(*pose, 0).right, sound.right)
    assert (columns, rows) == pytest.approx((1.5, -0.5), abs=0.15)


def test_declared_distortion_can_be_undone(room):
    distortion = (-0.2, 0.05, 0.001, -0.001)
    bent = model_of(room, left_distortion=distortion)
    pose = ((0.0, 0.1, -1.5), NORTH)
    straight, curved = model_of(room).render(*pose, 0).left, bent.render(*pose, 0).left
    eye = bent.calibration.left
    camera = np.array(
        [[eye.focal_x_px, 0, eye.centre_x_px], [0, eye.focal_y_px, eye.centre_y_px], [0, 0, 1]]
    )
    undone = cv2.undistort(curved, camera, np.array(eye.distortion))

    assert eye.distortion == distortion
    before, after = (np.abs(i.astype(float) - straight)[6:-6, 6:-6] for i in (curved, undone))
    assert after.mean() < 0.4 * before.mean()


def test_several_poses_in_one_exposure_blur_the_image(room):
    model = model_of(room)
    turns = [matrix_from_euler(0.0, 0.0, yaw_rad) for yaw_rad in np.linspace(-0.04, 0.04, 7)]
    sharp = model.render((0.0, 0.0, -1.5), NORTH, 0).left.astype(float)
    blurred = model.render_exposure([((0.0, 0.0, -1.5), turn) for turn in turns], 0).left

    def edges(image, axis):
        return np.abs(np.diff(image.astype(float), axis=axis)).mean()

    assert edges(blurred, 1) < 0.6 * edges(sharp, 1)
    assert edges(blurred, 1) / edges(sharp, 1) < edges(blurred, 0) / edges(sharp, 0)


def test_mount_moves_and_tilts_the_eyes(small):
    pose = ((0.0, 0.0, -1.5), NORTH)
    forward = model_of(small, mount_frd_m=(0.5, 0.0, 0.0))
    upward = model_of(small, mount_pitch_deg=30.0)

    np.testing.assert_allclose(forward.depth(*pose)[48, 60:68], 2.0, rtol=1e-5)
    assert upward.depth(*pose)[0, 64] < model_of(small).depth(*pose)[0, 64]


def test_mean_disparity_of_a_wall_and_of_the_room(quiet):
    near = quiet.depth((1.5, 0.0, -1.5), NORTH)
    far = quiet.depth((-1.5, 0.0, -1.5), NORTH)

    metre_px = quiet.calibration.disparity_metre_px
    assert mean_disparity_px(near, quiet.calibration) == pytest.approx(metre_px, rel=1e-5)
    assert metre_px / 4.0 < mean_disparity_px(far, quiet.calibration) < metre_px / 3.0


def test_settings_out_of_range_are_refused_with_their_key():
    with pytest.raises(PlanError, match=r"sitl: baseline_m: .*> 0"):
        convert_settings({"baseline_m": 0.0}, CameraSettings, "sitl")


def test_vehicle_that_is_nowhere_is_an_error(quiet):
    with pytest.raises(SimulatorError, match="nowhere"):
        quiet.render((math.nan, 0.0, -1.0), NORTH, 0)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (2.5, 0.0, -1.5), (9.0, 9.0, 9.0)])
def test_camera_on_or_beyond_a_surface_still_sees_one(small, place):
    for height_px in (96, 97):
        model = model_of(small, height_px=height_px, width_px=129)
        assert model.render(place, NORTH, 0).left.max() > 0
        assert np.isfinite(model.depth(place, NORTH)).all()
