"""g(x_g): a stereo pair to its average disparity λ (section III-C).

Every pixel of the left image is matched, also those at its left border: the images are padded
before matching, and a match counts where it lies inside the right image. Which pixels count
therefore depends on the scene alone, not on how many disparities are searched.

OpenCV's thread pool costs more than it brings at this image size: see companion/threads.py.
"""

import math
from typing import Annotated, Literal, NamedTuple, cast

import cv2
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from companion.compiled import kernel
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import CameraError, PlanError
from companion.kernel.settings import Settings
from companion.vision.lens import CAM_FROM_FRD, Lens

Grey = NDArray[np.uint8]
Maps = tuple[NDArray[np.int16], NDArray[np.uint16]]
"""Where rectified pixels lie in the raw image: whole pixels, and OpenCV's code for the rest."""

Label = Literal["mean", "quantile"]

SUBPIXELS = 16
"""StereoBM counts disparity in sixteenths of a pixel."""

BACK_AND_FORTH_PX = 1
"""A match counts if matching back from the right image ends this near to where it began; that
rejects most of what only one eye sees."""

ALIGNED_PX = 0.05
"""Differences between the eyes below a sub-pixel step are not worth resampling for."""


class StereoSettings(Settings, frozen=True):
    """How the eyes are matched."""

    disparities_px: Annotated[int, Meta(ge=16, le=256, multiple_of=16)] = 32
    """Search range from infinity on; the nearest depth seen is focal x baseline / this."""
    block_px: Annotated[int, Meta(ge=5, le=51)] = 15
    """Side of the matched block, odd."""
    uniqueness_percent: Annotated[int, Meta(ge=0, le=100)] = 15
    """How much worse the second best match must be."""
    texture_threshold: Annotated[int, Meta(ge=0, le=100_000)] = 500
    """Least sum of horizontal gradients in a block; below it a match is a guess."""
    min_valid_norm: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.05
    """Below this share of matched pixels λ is unknown."""
    quantile_norm: Annotated[float, Meta(gt=0.0, lt=1.0)] = 0.24
    """The label "quantile" is the disparity that this share of the matched pixels exceeds."""

    def __post_init__(self) -> None:
        if self.block_px % 2 == 0:
            raise ValueError(f"block_px must be odd, got {self.block_px}")


class StereoResult(NamedTuple):
    """λ and how far to trust it. Pixels of the rectified image; NaN where unknown."""

    disparity_px: float
    """The chosen label."""
    valid_norm: float
    """Matched pixels over all pixels."""
    mean_px: float
    quantile_px: float


class Matches(NamedTuple):
    """What was compared and found.

    left, right: rectified; sixteenths: (height, width) int16, disparity of the left eye's pixels
    with infinity's in it, below ``least_px`` where unmatched.
    """

    left: Grey
    right: Grey
    sixteenths: NDArray[np.int16]
    least_px: int
    infinity_px: float

    def disparity_px(self) -> NDArray[np.float32]:
        """(height, width), NaN where unmatched; infinity has 0."""
        return self.disparity_at_px(np.s_[:], np.arange(self.sixteenths.shape[1]))

    def disparity_at_px(
        self, rows: NDArray[np.intp] | slice, columns: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """The same at some pixels of the left image."""
        raw = self.sixteenths[rows, columns]
        most = columns * SUBPIXELS
        least = np.maximum(
            self.least_px * SUBPIXELS, most - (self.sixteenths.shape[1] - 1) * SUBPIXELS
        )
        disparity_px = (raw / SUBPIXELS - self.infinity_px).astype(np.float32)
        disparity_px[(raw < least) | (raw > most)] = np.nan
        return disparity_px


class StereoMatcher:
    """Block matching for one calibrated camera; ``label`` chooses what λ is."""

    def __init__(
        self, settings: StereoSettings, calibration: StereoCalibration, label: Label = "mean"
    ) -> None:
        self.settings = settings
        self.calibration = calibration
        self.label = label
        self._rectify = _Rectifier(calibration)
        self._infinity_px = self._rectify.disparity_at_infinity_px
        # One below infinity, so that the far end of the range has a neighbour to interpolate with.
        self._least_px = math.floor(self._infinity_px) - 1
        half_block_px = settings.block_px // 2
        most_px = self._least_px + settings.disparities_px
        self._pad_left_px = max(most_px, 0) + half_block_px
        self._pad_right_px = max(-self._least_px, 0) + half_block_px
        self._matcher = self._make_matcher()
        self._matches: Matches | None = None

    @property
    def disparity_metre_px(self) -> float:
        """Disparity of a point at 1 m depth in the rectified image."""
        return self._rectify.lens.focal_px * self.calibration.baseline_m

    @property
    def lens(self) -> Lens:
        """Of the rectified left image."""
        return self._rectify.lens

    def match(self, left: Grey, right: Grey) -> StereoResult:
        """λ of a raw pair, both (height, width)."""
        self._matches = self._match_raw(left, right)
        raw = self._matches.sixteenths
        exceeding_norm = self.settings.quantile_norm
        n_valid, mean, quantile = _summarise(raw, self._least_px, exceeding_norm)
        valid_norm = n_valid / raw.size
        if n_valid == 0 or valid_norm < self.settings.min_valid_norm:
            return StereoResult(math.nan, valid_norm, math.nan, math.nan)
        mean_px = mean / SUBPIXELS - self._infinity_px
        quantile_px = quantile / SUBPIXELS - self._infinity_px
        chosen_px = mean_px if self.label == "mean" else quantile_px
        return StereoResult(chosen_px, valid_norm, mean_px, quantile_px)

    def disparity_map(self, left: Grey, right: Grey) -> NDArray[np.float32]:
        """disparity_px: (height, width) of the rectified left image, NaN where unmatched."""
        self._matches = self._match_raw(left, right)
        return self.last_map()

    def last_matches(self) -> Matches:
        """Those of the pair matched last."""
        if self._matches is None:
            raise RuntimeError("this needs a pair that was matched")
        return self._matches

    def last_map(self) -> NDArray[np.float32]:
        """The map of the pair matched last, as ``disparity_map``; it costs no second match."""
        return self.last_matches().disparity_px()

    def _match_raw(self, left: Grey, right: Grey) -> Matches:
        self._check_geometry(left, right)
        left, right = self._rectify(left, right)
        matched = self._matcher.compute(self._pad(left), self._pad(right))
        sixteenths = cast(NDArray[np.int16], matched[:, self._pad_left_px : -self._pad_right_px])
        return Matches(left, right, sixteenths, self._least_px, self._infinity_px)

    def _pad(self, image: Grey) -> Grey:
        left_px, right_px = self._pad_left_px, self._pad_right_px
        return cast(Grey, cv2.copyMakeBorder(image, 0, 0, left_px, right_px, cv2.BORDER_REPLICATE))

    def _check_geometry(self, left: Grey, right: Grey) -> None:
        declared = (self.calibration.height_px, self.calibration.width_px)
        for eye, image in (("left", left), ("right", right)):
            if image.shape != declared or image.dtype != np.uint8:
                raise CameraError(
                    f"{eye} image is {image.dtype} of shape {image.shape}; "
                    f"the calibration declares uint8 of shape {declared}"
                )

    def _make_matcher(self) -> cv2.StereoBM:
        settings = self.settings
        smaller_px = min(self.calibration.height_px, self.calibration.width_px)
        if settings.block_px >= smaller_px:
            raise PlanError(
                f"stereo.block_px: {settings.block_px} does not fit the camera's image; "
                f"allowed: below {smaller_px}"
            )
        matcher = cv2.StereoBM.create(settings.disparities_px, settings.block_px)
        matcher.setMinDisparity(self._least_px)
        matcher.setUniquenessRatio(settings.uniqueness_percent)
        matcher.setTextureThreshold(settings.texture_threshold)
        matcher.setDisp12MaxDiff(BACK_AND_FORTH_PX)
        return matcher


class _Rectifier:
    """Brings both eyes to one focal length and common rows; does nothing where they have them."""

    def __init__(self, calibration: StereoCalibration) -> None:
        self.lens = Lens(calibration.left)
        self.disparity_at_infinity_px = calibration.disparity_at_infinity_px
        self._maps: tuple[Maps, ...] = ()
        if not _is_aligned(calibration):
            self._plan_resampling(calibration)

    def __call__(self, left: Grey, right: Grey) -> tuple[Grey, Grey]:
        if not self._maps:
            return left, right
        left_map, right_map = self._maps
        return _resample(left, left_map), _resample(right, right_map)

    def _plan_resampling(self, calibration: StereoCalibration) -> None:
        size = (calibration.width_px, calibration.height_px)
        eyes = [(_matrix(eye), np.array(eye.distortion)) for eye in _eyes(calibration)]
        right_from_left = np.array(calibration.right_from_left).reshape(3, 3)
        shift_m = np.array([[-calibration.baseline_m], [0.0], [0.0]])
        turn_left, turn_right, left, right, *_ = cv2.stereoRectify(
            *eyes[0], *eyes[1], size, right_from_left, shift_m, alpha=0.0
        )
        pinhole = Intrinsics(left[0, 0], left[1, 1], left[0, 2], left[1, 2])
        self.lens = Lens(pinhole, turn_left @ CAM_FROM_FRD)
        self.disparity_at_infinity_px = float(left[0, 2] - right[0, 2])
        self._maps = tuple(
            cast(Maps, cv2.initUndistortRectifyMap(*eye, turn, projection, size, cv2.CV_16SC2))
            for eye, turn, projection in zip(
                eyes, (turn_left, turn_right), (left, right), strict=True
            )
        )


def _resample(image: Grey, maps: Maps) -> Grey:
    steps, fractions = maps
    return cast(
        Grey,
        cv2.remap(image, steps, fractions, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
    )


def _eyes(calibration: StereoCalibration) -> tuple[Intrinsics, Intrinsics]:
    return calibration.left, calibration.right


def _matrix(eye: Intrinsics) -> NDArray[np.float64]:
    return np.array(
        [
            [eye.focal_x_px, 0.0, eye.centre_x_px],
            [0.0, eye.focal_y_px, eye.centre_y_px],
            [0.0, 0.0, 1.0],
        ]
    )


def _is_aligned(calibration: StereoCalibration) -> bool:
    """True where the eyes differ by a shift along the rows only, anywhere in the image."""
    left, right = _eyes(calibration)
    reach_norm = max(
        calibration.width_px / left.focal_x_px, calibration.height_px / left.focal_y_px
    )
    turn = np.array(calibration.right_from_left).reshape(3, 3) - np.eye(3)
    differences_px = (
        (left.focal_x_px - right.focal_x_px) * reach_norm,
        (left.focal_y_px - right.focal_y_px) * reach_norm,
        left.centre_y_px - right.centre_y_px,
        float(np.abs(turn).max()) * left.focal_x_px,
    )
    undistorted = not any(left.distortion) and not any(right.distortion)
    return undistorted and max(map(abs, differences_px)) < ALIGNED_PX


# The signature is given so that it is compiled, or read from the cache, before take-off.
@kernel("Tuple((i8, f8, f8))(i2[:,:], i8, f8)")
def _summarise(
    raw: NDArray[np.int16], least_px: int, exceeding_norm: float
) -> tuple[int, float, float]:
    """(matches inside the right image, their mean, the value exceeded by that share of them)."""
    height, width = raw.shape
    least = least_px * SUBPIXELS
    counts = np.zeros(width * SUBPIXELS - least + 1, dtype=np.int64)
    n_valid = 0
    total = 0
    for row in range(height):
        for column in range(width):
            value = raw[row, column]
            beyond_right = (column - width + 1) * SUBPIXELS
            if max(least, beyond_right) <= value <= column * SUBPIXELS:
                counts[value - least] += 1
                total += value
                n_valid += 1
    if n_valid == 0:
        return 0, np.nan, np.nan
    exceeding = 0
    place = len(counts) - 1
    while exceeding + counts[place] <= exceeding_norm * n_valid:
        exceeding += counts[place]
        place -= 1
    return n_valid, total / n_valid, float(place + least)
