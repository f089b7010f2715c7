"""One eye of a camera that looks ahead, mounted level: rays and pixels, and where it points."""

from typing import Self, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.frames import matrix_from_euler
from companion.kernel.messages import Telemetry

Grey = NDArray[np.uint8]
Floats = NDArray[np.float64]
Points = NDArray[np.float32]
"""(n, 1, 2), pixels: the form that OpenCV follows points in."""

LEVEL_LSB = 110.0
"""Mean grey that images are brought to: exposure changes between them."""
CAM_FROM_FRD: Floats = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


class Lens:
    """Pinhole with distortion; ``cam_from_frd`` (3, 3) turns the body's axes into its own."""

    def __init__(self, intrinsics: Intrinsics, cam_from_frd: Floats = CAM_FROM_FRD) -> None:
        self.focal_px = intrinsics.focal_x_px
        self._matrix: Floats = np.array(
            [
                [intrinsics.focal_x_px, 0.0, intrinsics.centre_x_px],
                [0.0, intrinsics.focal_y_px, intrinsics.centre_y_px],
                [0.0, 0.0, 1.0],
            ]
        )
        self._distortion = np.array(intrinsics.distortion)
        self.cam_from_frd = cam_from_frd

    @classmethod
    def of(cls, calibration: StereoCalibration, eye: str) -> Self:
        """Of the raw image of the left or the right eye."""
        if eye == "left":
            return cls(calibration.left)
        right_from_left = np.array(calibration.right_from_left).reshape(3, 3)
        return cls(calibration.right, right_from_left @ CAM_FROM_FRD)

    def cam_from_ned(self, telemetry: Telemetry) -> Floats:
        """(3, 3); NaN where the attitude is unknown."""
        attitude_rad = telemetry.roll_rad, telemetry.pitch_rad, telemetry.yaw_rad
        turn: Floats = self.cam_from_frd @ matrix_from_euler(*attitude_rad).T
        return turn

    def rays_of(self, points: Points) -> Floats:
        """(n, 3), of unit depth."""
        flat = cv2.undistortPoints(points, self._matrix, self._distortion).reshape(-1, 2)
        return np.column_stack([flat, np.ones(len(flat))]).astype(np.float64)

    def project(self, places: Floats) -> Points:
        """Where (n, 3) places in its own axes are seen."""
        nothing = np.zeros(3)
        points, _ = cv2.projectPoints(places, nothing, nothing, self._matrix, self._distortion)
        return points.astype(np.float32)


def grid_of(width_px: int, height_px: int, spacing_px: int, margin_px: int) -> Points:
    """Whole pixels evenly over the image, row by row."""
    columns, rows = np.meshgrid(
        np.arange(margin_px, width_px - margin_px, spacing_px),
        np.arange(margin_px, height_px - margin_px, spacing_px),
    )
    return np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float32)


def levelled(image: Grey) -> Grey:
    """Brought to the same mean."""
    return cast(Grey, cv2.convertScaleAbs(image, alpha=LEVEL_LSB / max(float(image.mean()), 1.0)))
