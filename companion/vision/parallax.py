"""How near things are, from how one eye's image moved while the vehicle flew on.

A point that stands still moves across the image by its nearness times the way flown, once the
turn of the camera is taken out. One eye that flew a quarter of a metre has a wider baseline than
two eyes, and knows nothing while it hovers. The way flown is the autopilot's estimate.
"""

import math
from collections import deque
from typing import NamedTuple

import cv2
import numpy as np

from companion.kernel.calibration import StereoCalibration
from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import Telemetry
from companion.vision.lens import Floats, Grey, Lens, grid_of, levelled
from companion.vision.wayflown import WayFlown

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
RANGE_PER_M = (-0.15, 5.0)
"""Of a believable point's nearness."""
TYPICAL_PER_M = 0.3
"""Where points are looked for first, before anything is known."""


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
        self._lens = Lens.of(calibration, eye)
        size_px = calibration.width_px, calibration.height_px
        self._points = grid_of(*size_px, SPACING_PX, MARGIN_PX)
        self._rays = self._lens.rays_of(self._points)
        self._views: deque[_View] = deque()
        self._way = WayFlown()
        self._nearness_per_m = TYPICAL_PER_M

    def forget(self) -> None:
        """The next image does not follow the last one."""
        self._views.clear()
        self._way.restart()

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
        way_ned_m = self._way.advance(stamp_ns, telemetry)
        cam_from_ned = self._lens.cam_from_ned(telemetry)
        if way_ned_m is None or not np.isfinite(cam_from_ned).all():
            return None
        return _View(stamp_ns, levelled(image), way_ned_m, cam_from_ned, telemetry.yaw_rad)

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
        expected = self._lens.project(turned + self._nearness_per_m * way_m)
        found, followed, _ = cv2.calcOpticalFlowPyrLK(
            now.image, earlier.image, self._points, expected,
            winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            minEigThreshold=LEAST_TEXTURE,
        )  # fmt: skip
        rays = self._lens.rays_of(np.asarray(found, dtype=np.float32))
        # Both rows of: ray x (turned + nearness * way) = 0; least squares for each point.
        lever = rays[:, :2] * way_m[2] - way_m[:2]
        moved = turned[:, :2] - rays[:, :2] * turned[:, 2:]
        lever_square = (lever**2).sum(axis=1)
        nearness = (lever * moved).sum(axis=1) / np.maximum(lever_square, 1e-12)
        astray = (
            np.linalg.norm(moved - nearness[:, np.newaxis] * lever, axis=1) * self._lens.focal_px
        )
        good = (
            (followed[:, 0] == 1)
            & (astray < MOST_ASTRAY_PX)
            & (lever_square * self._lens.focal_px**2 > LEAST_LEVER_PX_M)
            & (nearness > RANGE_PER_M[0])
            & (nearness < RANGE_PER_M[1])
        )
        return float(nearness[good].mean()) if good.sum() >= LEAST_POINTS else math.nan
