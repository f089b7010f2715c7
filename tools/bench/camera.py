"""One stereo pair of the simulator, beside the plainest renderer of an empty room."""

from collections.abc import Iterator
from itertools import cycle

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.calibration import StereoCalibration
from companion.kernel.frames import matrix_from_euler
from sitl.arena.camera import FRD_FROM_CAM, CameraSettings, StereoCameraModel
from sitl.arena.room import load_room
from tools.bench.harness import PLAN, Row, race_row

POSITION_NED_M = (0.6, -0.4, -1.2)
TEXTURE_PX = 1024
SEED = 1


def rows() -> Iterator[Row]:
    room = load_room(PLAN.parent / "rooms" / "room1.toml")
    rng = np.random.default_rng(SEED)
    model = StereoCameraModel(room, CameraSettings(), rng)
    plain = PlainRenderer(room.bounds_ned_m, model.calibration, rng)
    poses = [matrix_from_euler(0.02, -0.03, yaw_rad) for yaw_rad in rng.uniform(-3, 3, 16)]
    ours, theirs = cycle(poses), cycle(poses)
    yield race_row(
        "render a stereo pair, room 1",
        lambda: model.render(POSITION_NED_M, next(ours), 0),
        ("numpy rays + cv2.remap, empty room", lambda: plain.render(next(theirs))),
        goal=1.0,
    )


class PlainRenderer:
    """Six textured planes, two eyes: no objects, no light, no blur, no noise."""

    def __init__(
        self,
        bounds_ned_m: NDArray[np.float64],
        calibration: StereoCalibration,
        rng: np.random.Generator,
    ) -> None:
        eye = calibration.left
        columns, rows = np.meshgrid(
            np.arange(calibration.width_px), np.arange(calibration.height_px)
        )
        x = (columns - eye.centre_x_px) / eye.focal_x_px
        y = (rows - eye.centre_y_px) / eye.focal_y_px
        self._rays_frd = np.stack([x, y, np.ones_like(x)], axis=-1) @ FRD_FROM_CAM.T
        self._bounds_ned_m = bounds_ned_m
        self._half_baseline_m = calibration.baseline_m / 2
        self._texture = rng.integers(0, 256, (TEXTURE_PX, TEXTURE_PX), dtype=np.uint8)

    def render(self, ned_from_frd: NDArray[np.float64]) -> list[NDArray[np.uint8]]:
        rays = self._rays_frd @ ned_from_frd.T
        right = ned_from_frd[:, 1] * self._half_baseline_m
        return [self._see(rays, np.array(POSITION_NED_M) + side * right) for side in (-1.0, 1.0)]

    def _see(self, rays: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.uint8]:
        """The nearest wall ahead along every ray, and its texel."""
        walls = np.where(rays > 0.0, self._bounds_ned_m[1], self._bounds_ned_m[0])
        ranges = (walls - origin) / rays
        axis = ranges.argmin(axis=-1)[..., None]
        hit = origin + rays * np.take_along_axis(ranges, axis, axis=-1)
        along = np.where(axis == 0, hit[..., 1:2], hit[..., 0:1])
        across = np.where(axis == 2, hit[..., 1:2], hit[..., 2:3])
        scale = TEXTURE_PX / np.ptp(self._bounds_ned_m)
        along_px, across_px = (
            (place[..., 0] * scale % TEXTURE_PX).astype(np.float32) for place in (along, across)
        )
        seen = cv2.remap(
            self._texture, along_px, across_px, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
        )
        return np.asarray(seen, dtype=np.uint8)
