"""Rays: depth against geometry done another way, and texture that neither flickers nor shifts."""

import math
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.kernel.frames import matrix_from_euler
from sitl.arena.camera import FRD_FROM_CAM, CameraSettings, StereoCameraModel
from sitl.arena.raycast import build_eye
from sitl.arena.room import BoxSettings, CylinderSettings, RoomSettings, SurfaceSettings, build_room

SETTINGS = CameraSettings(
    mount_frd_m=(0.0, 0.03, 0.0), read_noise_lsb=0.0, shot_noise_white_lsb=0.0, vignetting_norm=0.0
)
"""Without noise, and with the left eye in the vehicle's centre."""
ROOM = build_room(
    RoomSettings(
        size_m=(6.0, 4.0, 3.0),
        texel_m=0.01,
        box=(
            BoxSettings(centre_m=(1.5, 0.5, 0.5), size_m=(1.0, 0.6, 1.0)),
            BoxSettings(centre_m=(-1.5, -1.0, 2.0), size_m=(0.4, 0.8, 0.6)),
        ),
        cylinder=(
            CylinderSettings(centre_m=(0.0, 1.2), radius_m=0.3, height_m=1.2, bottom_m=0.4),
            CylinderSettings(centre_m=(-1.0, 1.0), radius_m=0.2, height_m=3.0),
        ),
    ),
    Path("room.toml"),
)

poses = st.tuples(
    st.floats(-2.8, 2.8),
    st.floats(-1.8, 1.8),
    st.floats(-2.8, -0.2),
    st.floats(-0.5, 0.5),
    st.floats(-1.2, 1.2),
    st.floats(-math.pi, math.pi),
)


@pytest.fixture(scope="module")
def camera():
    """Hypothesis may share it between examples: depth depends on nothing but the pose."""
    return StereoCameraModel(ROOM, SETTINGS, np.random.default_rng(1))


def rays_ned(camera, ned_from_frd):
    eye = camera.calibration.left
    columns, rows = np.meshgrid(np.arange(128.0), np.arange(96.0))
    x, y = (columns - eye.centre_x_px) / eye.focal_x_px, (rows - eye.centre_y_px) / eye.focal_y_px
    return np.stack([x, y, np.ones_like(x)], axis=-1) @ (ned_from_frd @ FRD_FROM_CAM).T


def clearance_m(position, rays, depth_m):
    """Signed distance to the nearest surface at these depths, for every ray."""
    points = np.asarray(position) + rays * depth_m[..., None]
    low, high = ROOM.bounds_ned_m
    distance = np.minimum(points - low, high - points).min(axis=-1)
    for box in ROOM.boxes_ned_m:
        outside = np.maximum(box[:3] - points, points - box[3:]).max(axis=-1)
        distance = np.minimum(distance, outside)
    for north, east, radius, top, foot in ROOM.cylinders_ned_m:
        beside = np.hypot(points[..., 0] - north, points[..., 1] - east) - radius
        above = np.maximum(top - points[..., 2], points[..., 2] - foot)
        distance = np.minimum(distance, np.maximum(beside, above))
    return distance


@settings(max_examples=40)
@given(poses)
def test_every_ray_ends_on_a_surface_and_passes_through_none(camera, pose):
    position, ned_from_frd = pose[:3], matrix_from_euler(*pose[3:])
    rays = rays_ned(camera, ned_from_frd)
    if clearance_m(position, rays, np.zeros((96, 128))).min() < 0.01:
        return  # inside a box or pillar, where nothing is promised
    depth_m = camera.depth(position, ned_from_frd).astype(np.float64)

    np.testing.assert_allclose(clearance_m(position, rays, depth_m), 0.0, atol=2e-3)
    for share in np.linspace(0.1, 0.95, 8):
        assert clearance_m(position, rays, depth_m * share).min() > -2e-3


def test_depth_is_along_the_optical_axis(camera):
    depth_m = camera.depth((0.0, -1.2, -1.5), matrix_from_euler(0.0, 0.0, 0.0))
    np.testing.assert_allclose(depth_m[40:56, 40:80], 3.0, rtol=1e-5)


def test_any_size_of_image_sees_the_same_room(camera):
    large = StereoCameraModel(
        ROOM,
        CameraSettings(width_px=250, height_px=190, mount_frd_m=(0.0, 0.03, 0.0)),
        np.random.default_rng(1),
    )
    pose = (-2.0, 0.2, -1.2), matrix_from_euler(0.1, -0.1, 0.3)
    depth_m = large.depth(*pose)

    assert depth_m.shape == (190, 250)
    assert np.median(depth_m) == pytest.approx(np.median(camera.depth(*pose)), rel=0.02)
    assert large.render(*pose, 0).right.shape == (190, 250)


def test_cones_hold_every_ray_of_their_tile(camera):
    rays = np.random.default_rng(2).uniform(-0.6, 0.6, (50, 70, 2)).astype(np.float32)
    eye = build_eye(rays, 100.0)

    assert len(eye.rays) == len(eye.cones) == 4 * 5
    for (x, y), (*axis, cosine, sine) in zip(eye.rays, eye.cones, strict=True):
        directions = np.stack([x, y, np.ones_like(x)], axis=1)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        assert (directions @ axis >= cosine).all()
        assert math.hypot(cosine, sine) == pytest.approx(1.0, abs=1e-5)


def hall(texture, size_m=(20.0, 20.0, 3.0)):
    surfaces = {
        name: SurfaceSettings(texture=texture)
        for name in ("north", "east", "south", "west", "floor", "ceiling")
    }
    plain = {"light": {"ambient_norm": 1.0}, "texel_m": 0.008, "size_m": size_m}
    base = msgspec.convert(plain, RoomSettings)
    room = msgspec.structs.replace(base, surface=msgspec.structs.replace(base.surface, **surfaces))
    return StereoCameraModel(
        build_room(room, Path("hall.toml")), SETTINGS, np.random.default_rng(1)
    )


@pytest.fixture(scope="module")
def noisy_hall():
    return hall("noise")


def test_texture_fades_with_distance(noisy_hall):
    level = matrix_from_euler(0.0, 0.0, 0.0)
    grain = []
    for distance_m in (1.0, 3.0, 9.0):
        left = noisy_hall.render((10.0 - distance_m, 2.0, -1.5), level, 0).left.astype(float)
        left = left[40:56]
        grain.append(np.abs(np.diff(left, axis=1)).mean() / left.mean())

    assert grain[0] < grain[1]  # 1/f texture: more of its octaves fall into the image from afar
    assert grain[2] < 3.0 * grain[1]


@pytest.mark.parametrize("pitch_deg", [0, -25, -50])
def test_image_moves_smoothly_when_the_camera_creeps(noisy_hall, pitch_deg):
    """Aliasing would make single texels flash up between two nearly equal poses."""
    level = matrix_from_euler(0.0, math.radians(pitch_deg), 0.4)
    frames = [
        noisy_hall.render((0.002 * step, 0.0, -1.0), level, 0).left.astype(float)
        for step in range(8)
    ]
    changes = [np.abs(b - a).mean() for a, b in pairwise(frames)]
    contrast = frames[0].std()

    assert max(changes) < 0.08 * contrast


def test_oblique_texture_is_stretched_along_the_view_only(noisy_hall):
    """Averaging along the wide side of a footprint keeps what lies across it sharp."""
    grazing = matrix_from_euler(0.0, math.radians(-8.0), 0.0)
    left = noisy_hall.render((-5.0, 0.0, -0.5), grazing, 0).left.astype(float)
    floor = left[70:90]
    across, along = np.abs(np.diff(floor, axis=1)).mean(), np.abs(np.diff(floor, axis=0)).mean()

    assert across > 0.5 * along
