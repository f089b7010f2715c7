"""What stereo sees of the vehicle's motion, beside OpenCV's own way to a camera's pose."""

from collections.abc import Iterator
from itertools import cycle

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.kernel.messages import Telemetry
from companion.vision.odometry import Odometry
from companion.vision.stereo import Matches, StereoMatcher, StereoSettings
from sitl.arena.camera import CameraSettings, StereoCameraModel
from sitl.arena.room import load_room
from tools.bench.harness import PLAN, Row, race_row

PAIRS, RATE_HZ, SPEED_M_S = 20, 10.0, 0.5
SIZE_PX = 128, 96
APART = 2
"""Pairs between those that are compared, in flight as here."""
SEED = 1


def rows() -> Iterator[Row]:
    """A flight of two seconds through room 1, again and again."""
    room = load_room(PLAN.parent / "rooms" / "room1.toml")
    model = StereoCameraModel(room, CameraSettings(), np.random.default_rng(SEED))
    matcher = StereoMatcher(StereoSettings(), model.calibration)
    pairs = list(_flight(model, matcher))
    telemetry = Telemetry(
        velocity_ned_m_s=(SPEED_M_S, 0.0, 0.0), roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0
    )
    odometry = Odometry(matcher.lens, SIZE_PX, matcher.disparity_metre_px, (0.0, 0.0, 0.0))
    stamps = cycle(range(0, 10**15, round(1e9 / RATE_HZ)))
    ours = cycle(pairs)
    theirs = cycle(zip(pairs[:-APART:APART], pairs[APART::APART], strict=True))
    poser = _Poser(matcher)

    def observe() -> None:
        for _ in range(APART):
            stamp_ns = next(stamps)
            told = msgspec.structs.replace(telemetry, stamp_ns=stamp_ns)
            odometry.observe(next(ours), stamp_ns, told)

    yield race_row(
        "odometry: two pairs to a velocity",
        observe,
        ("OpenCV corners, flow and PnP", lambda: poser.pose(*next(theirs))),
        goal=0.6,
    )


def _flight(model: StereoCameraModel, matcher: StereoMatcher) -> Iterator[Matches]:
    for number in range(PAIRS):
        ahead_m = -1.0 + number * SPEED_M_S / RATE_HZ
        frame = model.render((ahead_m, 0.0, -1.2), np.eye(3), number)
        matcher.match(frame.left, frame.right)
        yield matcher.last_matches()


class _Poser:
    """Corners with a known depth, followed, to a pose by consensus."""

    def __init__(self, matcher: StereoMatcher) -> None:
        eye = matcher.calibration.left
        self._metre_px = matcher.disparity_metre_px
        self._matrix: NDArray[np.float64] = np.array(
            [
                [eye.focal_x_px, 0.0, eye.centre_x_px],
                [0.0, eye.focal_y_px, eye.centre_y_px],
                [0.0, 0.0, 1.0],
            ]
        )

    def pose(self, earlier: Matches, now: Matches) -> object:
        corners = cv2.goodFeaturesToTrack(earlier.left, 100, 0.01, 5)
        points, followed, _ = cv2.calcOpticalFlowPyrLK(
            earlier.left, now.left, corners, np.empty_like(corners)
        )
        columns, rows = corners.reshape(-1, 2).astype(np.intp).T
        disparity_px = earlier.disparity_px()[rows, columns]
        good = (followed[:, 0] == 1) & (disparity_px > 0.7)
        flat = cv2.undistortPoints(corners[good], self._matrix, np.zeros(4)).reshape(-1, 2)
        depth_m = self._metre_px / disparity_px[good, np.newaxis]
        places_m = np.column_stack([flat, np.ones(len(flat))]) * depth_m
        return cv2.solvePnPRansac(places_m, points[good], self._matrix, np.zeros(4))
