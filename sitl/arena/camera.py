"""The stereo camera on the vehicle: two eyes of one pose, lens, exposure and sensor noise."""

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import SimulatorError
from companion.kernel.frames import Vector3, matrix_from_euler
from companion.kernel.messages import StereoFrame
from companion.kernel.settings import Settings
from sitl.arena.atlas import build_atlas
from sitl.arena.jit import kernel
from sitl.arena.raycast import Eye, Floats, Pose, Scene, build_eye, build_scene, render_depth
from sitl.arena.room import Norm, Positive, Room, RoomSettings, build_room
from sitl.arena.shading import render

Pixels = Annotated[int, Meta(ge=8, le=4096)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Distortion = tuple[float, float, float, float]

FRD_FROM_CAM = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
WHITE_LSB = 255.0
NOISE_DRAWS = 1 << 18
EXPOSURE_LIMITS_LSB = (60.0, 1200.0)
"""Grey values per unit of radiance: the shortest and longest exposure."""


class CameraSettings(Settings, frozen=True):
    """Defaults: the 4 g stereo board of the paper's drone, 128 x 96 pixels, 60 mm baseline.

    ``misalignment_deg`` and ``centre_error_px`` are faults of the right eye that the declared
    calibration does not know; the distortions it does know.
    """

    width_px: Pixels = 128
    height_px: Pixels = 96
    horizontal_fov_deg: Annotated[float, Meta(ge=10.0, le=140.0)] = 57.4
    baseline_m: Positive = 0.06
    mount_frd_m: Vector3 = (0.1, 0.0, 0.0)
    """Middle between the eyes, from the vehicle's centre."""
    mount_pitch_deg: float = 0.0
    """Upwards."""
    left_distortion: Distortion = (0.0, 0.0, 0.0, 0.0)
    right_distortion: Distortion = (0.0, 0.0, 0.0, 0.0)
    misalignment_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector about CAM's right, down and forward."""
    centre_error_px: tuple[float, float] = (0.0, 0.0)
    vignetting_norm: Norm = 0.25
    """Share of the light that the corners lose."""
    blur_px: NotNegative = 0.4
    """Deviation of the lens's Gaussian blur."""
    read_noise_lsb: NotNegative = 1.2
    shot_noise_white_lsb: NotNegative = 1.8
    """Deviation at white; it falls with the square root of the grey value."""
    exposure_target_lsb: Annotated[float, Meta(ge=10.0, le=245.0)] = 130.0
    """Mean grey value that automatic exposure steers to."""
    exposure_frames: Annotated[float, Meta(ge=1.0)] = 4.0
    """Frames in which automatic exposure covers 63 % of a change."""
    exposure_s: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0
    """Time that the shutter is open, for motion blur; 0 freezes the motion."""


class _Half(NamedTuple):
    """One eye with its place: position in FRD from the vehicle's centre, attitude, light loss."""

    eye: Eye
    position_frd_m: NDArray[np.float64]
    frd_from_cam: NDArray[np.float64]
    transmission: Floats


class StereoCameraModel:
    """Renders what the two eyes see in a room; same generator, same poses: same bytes."""

    def __init__(self, room: Room, settings: CameraSettings, rng: np.random.Generator) -> None:
        self.settings = settings
        self._scene = _painted(room.settings, room.source)
        self._calibration = _declared_calibration(settings)
        self._halves = _build_halves(settings, self._calibration)
        self._rng = rng
        self._noise = rng.standard_normal(NOISE_DRAWS, np.float32)
        self._exposure_lsb: float | None = None
        self._compile()

    @property
    def calibration(self) -> StereoCalibration:
        """What the maker of the camera would state."""
        return self._calibration

    def render(
        self, position_ned_m: Vector3, ned_from_frd: NDArray[np.float64], stamp_ns: int
    ) -> StereoFrame:
        """The pair seen from this pose of the vehicle in the room's NED."""
        return self.render_exposure([(position_ned_m, ned_from_frd)], stamp_ns)

    def render_exposure(
        self, poses: Sequence[tuple[Vector3, NDArray[np.float64]]], stamp_ns: int
    ) -> StereoFrame:
        """The pair averaged over poses during one exposure: with several, motion blurs.

        Exposure reacts to this pair in the next one, except that the first pair is well exposed.
        """
        left, right = (self._radiance(half, poses) for half in self._halves)
        draws = self._rng.integers(NOISE_DRAWS, size=2).tolist()
        wanted_lsb = self._wanted_exposure_lsb(float(left.mean()))
        exposure_lsb = self._exposure_lsb or wanted_lsb
        share = 1.0 - math.exp(-1.0 / self.settings.exposure_frames)
        self._exposure_lsb = exposure_lsb * (wanted_lsb / exposure_lsb) ** share
        return StereoFrame(
            stamp_ns,
            self._develop(left, exposure_lsb, draws[0]),
            self._develop(right, exposure_lsb, draws[1]),
        )

    def depth(
        self, position_ned_m: Vector3, ned_from_frd: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Truth: (height, width) metres along the optical axis of the left eye."""
        depth_m = np.empty((self.settings.height_px, self.settings.width_px), np.float32)
        left = self._halves[0]
        render_depth(self._scene, left.eye, _pose(left, position_ned_m, ned_from_frd), depth_m)
        return depth_m

    def _compile(self) -> None:
        """Calls every kernel once, so that none is compiled while the vehicle flies."""
        pose = (0.0, 0.0, -1.0), np.eye(3)
        self._develop(self._radiance(self._halves[0], [pose]), 1.0, 0)
        self.depth(*pose)

    def _radiance(
        self, half: _Half, poses: Sequence[tuple[Vector3, NDArray[np.float64]]]
    ) -> Floats:
        radiance = np.zeros((self.settings.height_px, self.settings.width_px), np.float32)
        weight = np.float32(1.0 / len(poses))
        for position_ned_m, ned_from_frd in poses:
            pose = _pose(half, position_ned_m, ned_from_frd)
            render(self._scene, half.eye, pose, weight, radiance)
        if self.settings.blur_px > 0.0:
            blur_px = self.settings.blur_px
            size = 2 * math.ceil(2.5 * blur_px) + 1
            cv2.GaussianBlur(radiance, (size, size), blur_px, dst=radiance)
        radiance *= half.transmission
        return radiance

    def _wanted_exposure_lsb(self, mean_radiance: float) -> float:
        low, high = EXPOSURE_LIMITS_LSB
        return min(max(self.settings.exposure_target_lsb / max(mean_radiance, 1e-3), low), high)

    def _develop(self, radiance: Floats, exposure_lsb: float, first_draw: int) -> NDArray[np.uint8]:
        image = np.empty(radiance.shape, np.uint8)
        read_square = np.float32(self.settings.read_noise_lsb**2)
        shot_square = np.float32(self.settings.shot_noise_white_lsb**2 / WHITE_LSB)
        exposure = np.float32(exposure_lsb)
        _expose(radiance, exposure, read_square, shot_square, self._noise, first_draw, image)
        return image


@lru_cache(maxsize=2)
def _painted(settings: RoomSettings, source: Path) -> Scene:
    """Flights in the same room share its texels, which take a second or two to paint."""
    room = build_room(settings, source)
    return build_scene(room, build_atlas(room))


def mean_disparity_px(depth_m: NDArray[np.float32], calibration: StereoCalibration) -> float:
    """Truth: the mean over all pixels of focal length times baseline over depth."""
    inverse = np.reciprocal(depth_m, dtype=np.float64)
    return calibration.disparity_metre_px * float(inverse.mean())


def _declared_calibration(settings: CameraSettings) -> StereoCalibration:
    half_fov_rad = math.radians(settings.horizontal_fov_deg) / 2
    focal_px = settings.width_px / 2 / math.tan(half_fov_rad)
    centre = (settings.width_px - 1) / 2, (settings.height_px - 1) / 2
    return StereoCalibration(
        width_px=settings.width_px,
        height_px=settings.height_px,
        left=Intrinsics(focal_px, focal_px, *centre, settings.left_distortion),
        right=Intrinsics(focal_px, focal_px, *centre, settings.right_distortion),
        baseline_m=settings.baseline_m,
    )


def _build_halves(settings: CameraSettings, calibration: StereoCalibration) -> tuple[_Half, _Half]:
    pitch = matrix_from_euler(0.0, math.radians(settings.mount_pitch_deg), 0.0)
    frd_from_left = pitch @ FRD_FROM_CAM
    to_eye_m = frd_from_left @ (settings.baseline_m / 2, 0.0, 0.0)
    fault, _ = cv2.Rodrigues(np.radians(settings.misalignment_deg))
    light = _transmission(settings)
    left_rays = _rays(settings, calibration.left, (0.0, 0.0))
    right_rays = _rays(settings, calibration.right, settings.centre_error_px)
    focal_px, mount_m = calibration.left.focal_x_px, np.array(settings.mount_frd_m)
    return (
        _Half(build_eye(left_rays, focal_px), mount_m - to_eye_m, frd_from_left, light),
        _Half(build_eye(right_rays, focal_px), mount_m + to_eye_m, frd_from_left @ fault, light),
    )


def _rays(settings: CameraSettings, eye: Intrinsics, shift_px: tuple[float, float]) -> Floats:
    """(height, width, 2): x and y at depth 1 of each pixel's ray, distortion undone."""
    camera = np.array(
        [
            [eye.focal_x_px, 0.0, eye.centre_x_px + shift_px[0]],
            [0.0, eye.focal_y_px, eye.centre_y_px + shift_px[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    columns, rows = np.meshgrid(np.arange(settings.width_px), np.arange(settings.height_px))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
    rays = cv2.undistortPoints(pixels, camera, np.array(eye.distortion), None, None, None, criteria)
    return rays.reshape(settings.height_px, settings.width_px, 2).astype(np.float32)


def _transmission(settings: CameraSettings) -> Floats:
    """(height, width): 1 in the middle, falling with the square of the distance from it."""
    columns = np.linspace(-1.0, 1.0, settings.width_px) * settings.width_px
    rows = np.linspace(-1.0, 1.0, settings.height_px) * settings.height_px
    square = columns[None, :] ** 2 + rows[:, None] ** 2
    corner = settings.width_px**2 + settings.height_px**2
    return (1.0 - settings.vignetting_norm * square / corner).astype(np.float32)


def _pose(half: _Half, position_ned_m: Vector3, ned_from_frd: NDArray[np.float64]) -> Pose:
    position = np.array(position_ned_m) + ned_from_frd @ half.position_frd_m
    if not np.isfinite(position).all():
        raise SimulatorError(f"the camera is nowhere: vehicle at {position_ned_m}")
    rotation = ned_from_frd @ half.frd_from_cam
    return Pose(position.astype(np.float32), np.ascontiguousarray(rotation, np.float32))


@kernel
def _expose(
    radiance: Floats,
    exposure_lsb: np.float32,
    read_square: np.float32,
    shot_square: np.float32,
    noise: Floats,
    start: int,
    image: NDArray[np.uint8],
) -> None:
    """Radiance as 8-bit grey values with read and shot noise, noise draws from ``start`` on."""
    draws = noise.shape[0]
    place = start
    for row in range(radiance.shape[0]):
        for column in range(radiance.shape[1]):
            grey = radiance[row, column] * exposure_lsb
            deviation = math.sqrt(read_square + shot_square * grey)
            grey += deviation * noise[place] + np.float32(0.5)
            image[row, column] = np.uint8(min(max(grey, np.float32(0.0)), np.float32(WHITE_LSB)))
            place = place + 1 if place + 1 < draws else 0
