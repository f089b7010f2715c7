"""How near things are, from how one eye's image moved while the vehicle flew on.

A point that stands still moves across the image by its nearness times the way flown, once the
turn of the camera is taken out. One eye that flew a quarter of a metre has a wider baseline than
two eyes, and knows nothing while it hovers. The way flown is the autopilot's estimate.
"""

import math
from collections import deque
from typing import NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.calibration import StereoCalibration
from companion.kernel.frames import matrix_from_euler, wrap_angle_rad
from companion.kernel.messages import Telemetry

Grey = NDArray[np.uint8]
Floats = NDArray[np.float64]

WAY_M = 0.3
"""Two images so far apart are compared."""
LEAST_WAY_M, MEMORY_NS = 0.25, 2_000_000_000
"""The way may be a little shorter where the memory holds no image further back. While the vehicle
still gains speed, what the autopilot tells lags behind, and a short way would be much too short."""
MOST_TURN_RAD = 0.12
"""Further round, what is seen is no longer what was seen."""
SPACING_PX, MARGIN_PX, WINDOW_PX, LEVELS = 8, 6, 13, 1
LEAST_TEXTURE = 3e-3
"""Least eigenvalue of a window's gradients per pixel; below it a point cannot be followed."""
LEAST_LEVER_PX_M = 1.0
"""A point that moves less per nearness of 1/m lies too near to where the vehicle flies to."""
MOST_ASTRAY_PX = 3.0
"""A point further off the line that it must move along was followed wrongly."""
LEAST_POINTS = 20
LEVEL_LSB = 110.0
"""Mean grey that images are brought to: exposure changes between them."""
RANGE_PER_M = (-0.15, 5.0)
"""Of a believable point's nearness."""
TYPICAL_PER_M = 0.3
"""Where points are looked for first, before anything is known."""
CAM_FROM_FRD: Floats = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


class _View(NamedTuple):
    stamp_ns: int
    image: Grey
    way_ned_m: Floats
    """Flown since the first image, (3,)."""
    cam_from_ned: Floats
    yaw_rad: float


class Parallax:
    """Of one eye of a camera that looks ahead, mounted level."""

    def __init__(self, calibration: StereoCalibration, eye: str) -> None:
        intrinsics = calibration.left if eye == "left" else calibration.right
        self._focal_px = intrinsics.focal_x_px
        self._matrix: Floats = np.array(
            [
                [intrinsics.focal_x_px, 0.0, intrinsics.centre_x_px],
                [0.0, intrinsics.focal_y_px, intrinsics.centre_y_px],
                [0.0, 0.0, 1.0],
            ]
        )
        self._distortion = np.array(intrinsics.distortion)
        right_from_left = np.array(calibration.right_from_left).reshape(3, 3)
        self._cam_from_frd = CAM_FROM_FRD if eye == "left" else right_from_left @ CAM_FROM_FRD
        columns, rows = np.meshgrid(
            np.arange(MARGIN_PX, calibration.width_px - MARGIN_PX, SPACING_PX),
            np.arange(MARGIN_PX, calibration.height_px - MARGIN_PX, SPACING_PX),
        )
        self._points = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float32)
        self._rays = self._rays_of(self._points)
        self._views: deque[_View] = deque()
        self._velocity_ned_m_s: Floats = np.zeros(3)
        self._nearness_per_m = TYPICAL_PER_M

    def forget(self) -> None:
        """The next image does not follow the last one."""
        self._views.clear()

    def observe(self, image: Grey, stamp_ns: int, telemetry: Telemetry) -> float:
        """Mean inverse depth of what a raw image (height, width) shows, 1/m.

        NaN where too little way was flown, the turn was too wide, or too little can be followed.
        """
        view = self._view(image, stamp_ns, telemetry)
        if view is None:
            self.forget()
            return math.nan
        earlier = self._earlier(view)
        self._views.append(view)
        if earlier is None:
            return math.nan
        nearness_per_m = self._compare(earlier, view)
        if not math.isnan(nearness_per_m):
            self._nearness_per_m = min(max(nearness_per_m, 0.1), 2.0)
        return nearness_per_m

    def _view(self, image: Grey, stamp_ns: int, telemetry: Telemetry) -> _View | None:
        """None where the autopilot does not say how it moves, or time does not."""
        velocity_ned_m_s: Floats = np.array(telemetry.velocity_ned_m_s)
        attitude_rad = telemetry.roll_rad, telemetry.pitch_rad, telemetry.yaw_rad
        way_ned_m: Floats = np.zeros(3)
        if self._views:
            last = self._views[-1]
            passed_ns = stamp_ns - last.stamp_ns
            if not 0 < passed_ns <= MEMORY_NS:
                return None
            mean_m_s = (self._velocity_ned_m_s + velocity_ned_m_s) / 2.0
            way_ned_m = last.way_ned_m + mean_m_s * passed_ns * 1e-9
        if not (np.isfinite(way_ned_m).all() and all(map(math.isfinite, attitude_rad))):
            return None
        self._velocity_ned_m_s = velocity_ned_m_s
        cam_from_ned = self._cam_from_frd @ matrix_from_euler(*attitude_rad).T
        levelled = cv2.convertScaleAbs(image, alpha=LEVEL_LSB / max(float(image.mean()), 1.0))
        return _View(stamp_ns, cast(Grey, levelled), way_ned_m, cam_from_ned, telemetry.yaw_rad)

    def _earlier(self, view: _View) -> _View | None:
        """The newest image that lies far enough back, or the furthest that is remembered."""
        while self._views and view.stamp_ns - self._views[0].stamp_ns > MEMORY_NS:
            self._views.popleft()
        best, best_way_m = None, LEAST_WAY_M
        for earlier in reversed(self._views):
            if abs(wrap_angle_rad(view.yaw_rad - earlier.yaw_rad)) > MOST_TURN_RAD:
                break
            way_m = float(np.linalg.norm(view.way_ned_m - earlier.way_ned_m))
            if way_m > best_way_m:
                best, best_way_m = earlier, way_m
            if way_m >= WAY_M:
                break
        return best

    def _compare(self, earlier: _View, now: _View) -> float:
        """A point with ray r now lay at R r + nearness * t then, but for its length."""
        turned = self._rays @ (earlier.cam_from_ned @ now.cam_from_ned.T).T
        way_m = earlier.cam_from_ned @ (now.way_ned_m - earlier.way_ned_m)
        expected = self._project(turned + self._nearness_per_m * way_m)
        found, followed, _ = cv2.calcOpticalFlowPyrLK(
            now.image, earlier.image, self._points, expected,
            winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            minEigThreshold=LEAST_TEXTURE,
        )  # fmt: skip
        rays = self._rays_of(np.asarray(found, dtype=np.float32))
        # Both rows of: ray x (turned + nearness * way) = 0; least squares for each point.
        lever = rays[:, :2] * way_m[2] - way_m[:2]
        moved = turned[:, :2] - rays[:, :2] * turned[:, 2:]
        lever_square = (lever**2).sum(axis=1)
        nearness = (lever * moved).sum(axis=1) / np.maximum(lever_square, 1e-12)
        astray = np.linalg.norm(moved - nearness[:, np.newaxis] * lever, axis=1) * self._focal_px
        good = (
            (followed[:, 0] == 1)
            & (astray < MOST_ASTRAY_PX)
            & (lever_square * self._focal_px**2 > LEAST_LEVER_PX_M)
            & (nearness > RANGE_PER_M[0])
            & (nearness < RANGE_PER_M[1])
        )
        return float(nearness[good].mean()) if good.sum() >= LEAST_POINTS else math.nan

    def _rays_of(self, points: NDArray[np.float32]) -> Floats:
        """(n, 3), of unit depth."""
        flat = cv2.undistortPoints(points, self._matrix, self._distortion).reshape(-1, 2)
        return np.column_stack([flat, np.ones(len(flat))]).astype(np.float64)

    def _project(self, places: Floats) -> NDArray[np.float32]:
        nothing = np.zeros(3)
        points, _ = cv2.projectPoints(places, nothing, nothing, self._matrix, self._distortion)
        return points.astype(np.float32)
