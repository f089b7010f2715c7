"""Geometry of a calibrated stereo pair."""

import msgspec


class Intrinsics(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One eye: pinhole with radial-tangential distortion (k1, k2, p1, p2), pixels."""

    focal_x_px: float
    focal_y_px: float
    centre_x_px: float
    centre_y_px: float
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


class StereoCalibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Two eyes on one rigid mount.

    A point at ``p_left`` (CAM frame of the left eye, metres) is at
    ``R @ p_left - (baseline_m, 0, 0)`` in the right eye, R being ``right_from_left`` row by row.
    """

    width_px: int
    height_px: int
    left: Intrinsics
    right: Intrinsics
    baseline_m: float
    right_from_left: tuple[float, float, float, float, float, float, float, float, float] = (
        1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0,
    )  # fmt: skip

    @property
    def disparity_at_infinity_px(self) -> float:
        """x_left - x_right of a point infinitely far away, for unrotated eyes."""
        return self.left.centre_x_px - self.right.centre_x_px

    @property
    def disparity_metre_px(self) -> float:
        """Disparity of a point at 1 m depth: focal length times baseline."""
        return self.left.focal_x_px * self.baseline_m
