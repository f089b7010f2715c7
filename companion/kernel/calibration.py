"""Geometry of a calibrated stereo pair.

What is decoded from a file or a socket is checked here, once for all of them.
"""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

MOST_PX = 8192
"""Of an image's side: what is larger is no stereo camera, but a mistake or worse."""

Side = Annotated[int, Meta(ge=1, le=MOST_PX)]


class Intrinsics(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One eye: pinhole with radial-tangential distortion (k1, k2, p1, p2), pixels."""

    focal_x_px: float
    focal_y_px: float
    centre_x_px: float
    centre_y_px: float
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("focal_x_px", "focal_y_px"):
            _require_positive(name, getattr(self, name))
        _require_finite("centre", (self.centre_x_px, self.centre_y_px))
        _require_finite("distortion", self.distortion)


class StereoCalibration(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Two eyes on one rigid mount.

    A point at ``p_left`` (CAM frame of the left eye, metres) is at
    ``R @ p_left - (baseline_m, 0, 0)`` in the right eye, R being ``right_from_left`` row by row.
    """

    width_px: Side
    height_px: Side
    left: Intrinsics
    right: Intrinsics
    baseline_m: float
    right_from_left: tuple[float, float, float, float, float, float, float, float, float] = (
        1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        _require_positive("baseline_m", self.baseline_m)
        _require_finite("right_from_left", self.right_from_left)

    @property
    def disparity_at_infinity_px(self) -> float:
        """x_left - x_right of a point infinitely far away, for unrotated eyes."""
        return self.left.centre_x_px - self.right.centre_x_px

    @property
    def disparity_metre_px(self) -> float:
        """Disparity of a point at 1 m depth: focal length times baseline."""
        return self.left.focal_x_px * self.baseline_m


def _require_positive(name: str, value: float) -> None:
    if not 0.0 < value < math.inf:
        raise ValueError(f"{name}: {value}; must be above 0")


def _require_finite(name: str, values: tuple[float, ...]) -> None:
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{name}: {values}; must be finite numbers")
