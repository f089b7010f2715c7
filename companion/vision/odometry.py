"""How fast the stereo camera itself saw the vehicle move, beside what the autopilot says of it.

A point whose depth stereo knows moves across the image by the way the camera went; the turn, which
gyroscopes know well, is taken out. The way that explains how most points moved is the camera's.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.compiled import kernel
from companion.kernel.frames import Vector3
from companion.kernel.messages import Telemetry
from companion.kernel.telemetry_age import TelemetryAge
from companion.vision.lens import Floats, Grey, Lens, Points, grid_of, levelled
from companion.vision.stereo import Matches
from companion.vision.wayflown import WayFlown

LEAST_APART_NS, MOST_APART_NS = 190_000_000, 450_000_000
"""Of two pairs that are compared. Nearer ones show little but noise."""
MOST_TURN_RAD = 0.3
"""Further round, too little is seen twice."""
SPACING_PX, MARGIN_PX, WINDOW_PX, LEVELS = 12, 8, 11, 0
LEAST_TEXTURE = 3e-3
"""Least eigenvalue of a window's gradients per pixel; below it a point cannot be followed."""
LEAST_DISPARITY_PX = 0.7
"""A point further away hardly moves."""
LEAST_POINTS = 15
ROUNDS = 3
CONSISTENT_PX = 0.15
"""Points that are off by less count fully; the scale where most fit better than that."""
MOST_SCATTER_PX = 1.5
"""Where half of the points are off by more, nothing can be said."""


class _View(NamedTuple):
    stamp_ns: int
    image: Grey
    points: Points
    rays: Floats
    inverse_depth_per_m: Floats
    eye_ned_m: Floats
    """Where the eye is, as the autopilot tells it."""
    cam_from_ned: Floats


class Motion(NamedTuple):
    """Between two pairs, by the autopilot and by the camera: (3,) NED, m/s each."""

    told_ned_m_s: Floats
    seen_ned_m_s: Floats


class Odometry:
    """Compares a pair with one a fifth of a second before."""

    def __init__(
        self,
        lens: Lens,
        size_px: tuple[int, int],
        disparity_metre_px: float,
        eye_frd_m: Vector3,
    ) -> None:
        """``lens``: of the rectified left image, ``size_px`` its width and height; ``eye_frd_m``:
        where that eye is mounted."""
        self._lens = lens
        self._points = grid_of(*size_px, SPACING_PX, MARGIN_PX)
        self._columns, self._rows = self._points.reshape(-1, 2).astype(np.intp).T
        self._rays = lens.rays_of(self._points)
        self._eye_m: Floats = lens.cam_from_frd @ np.array(eye_frd_m)
        self._disparity_metre_px = disparity_metre_px
        self._way = WayFlown()
        self._age = TelemetryAge()
        self._earlier: _View | None = None

    def observe(self, matches: Matches, stamp_ns: int, telemetry: Telemetry) -> Motion | None:
        """How the left eye moved since the pair that was compared last.

        None where it is too early to compare, or nothing can be said. To be called with every pair,
        since the way flown in between is summed up here.
        """
        way_ned_m = self._way.advance(stamp_ns, telemetry)
        earlier = self._earlier
        if not self._age.is_usual(stamp_ns, telemetry.stamp_ns) or way_ned_m is None:
            self._earlier = None
            return None
        apart_ns = stamp_ns - earlier.stamp_ns if earlier else MOST_APART_NS + 1
        if apart_ns < LEAST_APART_NS:
            return None
        now = self._earlier = self._view(matches, stamp_ns, way_ned_m, telemetry)
        if earlier is None or now is None or apart_ns > MOST_APART_NS:
            return None
        told_ned_m = now.eye_ned_m - earlier.eye_ned_m
        seen_ned_m = self._compare(earlier, now, told_ned_m)
        if seen_ned_m is None:
            return None
        apart_s = apart_ns * 1e-9
        return Motion(told_ned_m / apart_s, seen_ned_m / apart_s)

    def _view(
        self, matches: Matches, stamp_ns: int, way_ned_m: Floats, telemetry: Telemetry
    ) -> _View | None:
        """With the points that stereo knows the depth of; None without an attitude."""
        cam_from_ned = self._lens.cam_from_ned(telemetry)
        if not np.isfinite(cam_from_ned).all():
            return None
        disparity_px = matches.disparity_at_px(self._rows, self._columns)
        known = disparity_px > LEAST_DISPARITY_PX  # False for NaN
        return _View(
            stamp_ns,
            levelled(matches.left),
            self._points[known],
            self._rays[known],
            (disparity_px[known] / self._disparity_metre_px).astype(np.float64),
            way_ned_m + cam_from_ned.T @ self._eye_m,
            cam_from_ned,
        )

    def _compare(self, earlier: _View, now: _View, told_ned_m: Floats) -> Floats | None:
        """The way of the camera, NED; a point at ray r of unit depth is now at R r - t / depth."""
        turn = now.cam_from_ned @ earlier.cam_from_ned.T
        if len(earlier.points) < LEAST_POINTS or np.trace(turn) < 1.0 + 2.0 * np.cos(MOST_TURN_RAD):
            return None
        turned = earlier.rays @ turn.T
        told_m = now.cam_from_ned @ told_ned_m
        expected = self._lens.project(turned - np.outer(earlier.inverse_depth_per_m, told_m))
        found, followed, _ = cv2.calcOpticalFlowPyrLK(
            earlier.image, now.image, earlier.points, expected,
            winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            minEigThreshold=LEAST_TEXTURE,
        )  # fmt: skip
        good = (followed[:, 0] == 1) & _inside(np.asarray(found), now.image.shape)
        if good.sum() < LEAST_POINTS:
            return None
        rays = self._lens.rays_of(np.asarray(found, dtype=np.float32)[good])
        inverse_per_m = earlier.inverse_depth_per_m[good]
        way_m, scatter_px = _way(turned[good], rays, inverse_per_m, self._lens.focal_px)
        return None if scatter_px > MOST_SCATTER_PX else now.cam_from_ned.T @ way_m


def _inside(points: NDArray[Any], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whose whole window lies in the image."""
    x, y = points.reshape(-1, 2).T
    half_px, (height_px, width_px) = WINDOW_PX // 2, shape
    return (x > half_px) & (y > half_px) & (x < width_px - half_px) & (y < height_px - half_px)


# The signature is given so that it is compiled, or read from the cache, before take-off.
@kernel("Tuple((f8[::1], f8))(f8[:,::1], f8[:,::1], f8[::1], f8)")
def _way(turned: Floats, rays: Floats, inverse: Floats, focal_px: float) -> tuple[Floats, float]:
    """Least squares in which a point counts the less the further off it is (Huber).

    turned, rays: (n, 3), inverse: (n,). Both rows of: x (Z - q t_z) = X - q t_x, with q the
    point's inverse depth before. Returns the way (3,), and by how many pixels half of the points
    are off at most.
    """
    n_points = len(rays)
    weight = np.ones(n_points)
    off_px = np.empty(n_points)
    way_m = np.zeros(3)
    scatter_px = np.inf
    for _ in range(ROUNDS):
        # Of the symmetric normal equations only t_x with t_y is nowhere coupled.
        level, x_ahead, y_ahead, ahead = 0.0, 0.0, 0.0, 0.0
        moved = np.zeros(3)
        for point in range(n_points):
            x, y = rays[point, 0], rays[point, 1]
            right = turned[point, 0] - x * turned[point, 2]
            down = turned[point, 1] - y * turned[point, 2]
            lever = weight[point] * inverse[point]
            square = lever * inverse[point]
            level += square
            x_ahead -= square * x
            y_ahead -= square * y
            ahead += square * (x * x + y * y)
            moved[0] += lever * right
            moved[1] += lever * down
            moved[2] -= lever * (x * right + y * down)
        rest = ahead - (x_ahead * x_ahead + y_ahead * y_ahead) / level
        way_m[2] = (moved[2] - (x_ahead * moved[0] + y_ahead * moved[1]) / level) / rest
        way_m[0] = (moved[0] - x_ahead * way_m[2]) / level
        way_m[1] = (moved[1] - y_ahead * way_m[2]) / level
        for point in range(n_points):
            x, y, q = rays[point, 0], rays[point, 1], inverse[point]
            right = turned[point, 0] - q * way_m[0] - x * (turned[point, 2] - q * way_m[2])
            down = turned[point, 1] - q * way_m[1] - y * (turned[point, 2] - q * way_m[2])
            off_px[point] = focal_px * np.sqrt(right * right + down * down)
        scatter_px = np.sort(off_px)[n_points // 2]
        weight = 1.0 / np.maximum(1.0, off_px / max(scatter_px, CONSISTENT_PX))
    return way_m, scatter_px
