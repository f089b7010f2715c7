"""Whether two sound images are a pair: one frame's signs of swapped, shifted or foreign eyes."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import kernel
from companion.health.eyes import Sign
from companion.kernel.messages import CameraFault
from companion.vision.stereo import Matches

SUBPIXELS = 16
BEYOND_PX = 0.75
"""A disparity this far below infinity's is none that a scene can have."""
BEYOND_NORM = 0.3
"""Of the matches."""
OFFSET_PX = 0.7
"""Between the rows of matched points; calibration keeps it below half a pixel."""
LEAST_MATCHES = 300
"""Of the points looked at, for an offset that means something."""
POOR_NORM = 0.4
"""With fewer matches these mean nothing, as before a wall that is nearer than the search reaches;
the eyes are then laid over each other to see why."""
NEAR_PX, BEYOND_REACH_PX, ROWS_PX = 48, 16, 8
"""How far they are shifted against each other then, in steps of 2 px: as near things are, as
nothing can be, and up or down."""
ALIGNED_NORM = 0.7
"""Difference at the best shift over that at the mean one: below it the shift means something."""
FAULTY_NORM = 0.85
"""Difference at the best shift over that at the best one of a sound pair: only below it does a
shift that a sound pair cannot have explain anything. 0.2 to 0.85 where rows are apart or the eyes
swapped; above 0.9 on what is nearer than the search reaches, where no single shift fits."""
FOREIGN_NORM = 0.9
"""Above it, nothing of one eye is in the other."""


class Pairing(NamedTuple):
    """Figures of one pair; NaN where too little matches to tell."""

    beyond_norm: float
    """Share of the matches with a disparity that nothing can have."""
    offset_px: float
    """How much lower the right eye's rows lie."""
    shift_px: tuple[int, int]
    """Right and down, that lays the eyes over each other best; looked for where few match."""
    alignment_norm: float
    """How well it does: see ALIGNED_NORM; NaN where it was not looked for."""
    faulty_norm: float
    """How much better than any shift that a sound pair can have: see FAULTY_NORM; NaN likewise."""


def pairing(matches: Matches, valid_norm: float) -> Pairing:
    """``valid_norm``: share of the pixels with a match."""
    n_matches, n_beyond, moment, weight = _compare(
        matches.left, matches.right, matches.sixteenths, matches.least_px,
        matches.infinity_px - BEYOND_PX,
    )  # fmt: skip
    told = n_matches >= LEAST_MATCHES and weight > 0.0
    beyond_norm = n_beyond / n_matches if told else math.nan
    offset_px = -moment / weight if told else math.nan
    shift_px, alignment_norm, faulty_norm = (0, 0), math.nan, math.nan
    if valid_norm < POOR_NORM:
        shift_x, shift_y, alignment_norm, faulty_norm = _overlay(
            matches.left, matches.right, matches.infinity_px - BEYOND_PX
        )
        shift_px = (shift_x, shift_y)
    return Pairing(beyond_norm, offset_px, shift_px, alignment_norm, faulty_norm)


def sign_of(pair: Pairing, valid_norm: float, infinity_px: float) -> Sign | None:
    """What one frame shows; None where nothing is wrong with it."""
    if math.isnan(pair.alignment_norm):
        return _sign_of_matches(pair)
    (right_px, down_px), matched = pair.shift_px, f"{valid_norm:.0%} of the pixels match"
    told = pair.alignment_norm < ALIGNED_NORM and pair.faulty_norm < FAULTY_NORM
    if told and down_px:
        return Sign(CameraFault.DECALIBRATED, f"rows {down_px:+d} px apart, {matched}")
    if told and right_px < infinity_px - BEYOND_PX:
        return Sign(CameraFault.SWAPPED, f"disparity {right_px:+d} px, {matched}")
    if pair.alignment_norm > FOREIGN_NORM:
        return Sign(CameraFault.UNMATCHED, f"overlay {pair.alignment_norm:.2f}, {matched}")
    return None


def _sign_of_matches(pair: Pairing) -> Sign | None:
    if pair.beyond_norm > BEYOND_NORM:
        return Sign(CameraFault.SWAPPED, f"{pair.beyond_norm:.0%} of the matches beyond infinity")
    if abs(pair.offset_px) > OFFSET_PX:
        return Sign(CameraFault.DECALIBRATED, f"rows {pair.offset_px:+.1f} px apart")
    return None


@kernel("Tuple((i8, i8, f8, f8))(u1[:,::1], u1[:,::1], i2[:,:], i8, f8)", fast=True)
def _compare(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    sixteenths: NDArray[np.int16],
    least_px: int,
    beyond_px: float,
) -> tuple[int, int, float, float]:
    """(matches looked at, those beyond, moment and weight of the vertical offset).

    One step of Lucas and Kanade's registration (1981), vertically, at every second pixel: the
    difference of matched pixels explained by the vertical gradient.
    """
    height, width = left.shape
    n_matches = n_beyond = 0
    moment = weight = 0.0
    for row in range(1, height - 1, 2):
        for column in range(0, width, 2):
            value = sixteenths[row, column]
            beside = column - (value + SUBPIXELS // 2) // SUBPIXELS
            if value < least_px * SUBPIXELS or beside < 0 or beside >= width:
                continue
            n_matches += 1
            n_beyond += value < beyond_px * SUBPIXELS
            gradient = (
                float(left[row + 1, column])
                - float(left[row - 1, column])
                + float(right[row + 1, beside])
                - float(right[row - 1, beside])
            ) / 4.0
            moment += gradient * (float(right[row, beside]) - float(left[row, column]))
            weight += gradient * gradient
    return n_matches, n_beyond, moment, weight


@kernel("Tuple((i8, i8, f8, f8))(u1[:,::1], u1[:,::1], f8)", fast=True)
def _overlay(
    left: NDArray[np.uint8], right: NDArray[np.uint8], beyond_px: float
) -> tuple[int, int, float, float]:
    """(x_left - x_right, y_right - y_left) of the best overlay, and its difference over the mean
    one and over the least one of a sound pair: rows level, no shift below ``beyond_px``.
    """
    height, width = left.shape[0] // 2, left.shape[1] // 2
    small = np.empty((2, height, width), np.int16)
    for row in range(height):
        for column in range(width):
            for eye, image in enumerate((left, right)):
                small[eye, row, column] = (
                    np.int16(image[2 * row, 2 * column])
                    + np.int16(image[2 * row, 2 * column + 1])
                    + np.int16(image[2 * row + 1, 2 * column])
                    + np.int16(image[2 * row + 1, 2 * column + 1])
                )
    near, beyond, reach_y = NEAR_PX // 2, BEYOND_REACH_PX // 2, ROWS_PX // 2
    least, sound, total, count, best_x, best_y = np.inf, np.inf, 0.0, 0, 0, 0
    for shift_y in range(-reach_y, reach_y + 1):
        for shift_x in range(-beyond, near + 1):
            difference = 0
            for row in range(reach_y, height - reach_y):
                for column in range(near, width - beyond):
                    difference += abs(
                        int(small[0, row, column]) - int(small[1, row + shift_y, column - shift_x])
                    )
            total += difference
            count += 1
            if shift_y == 0 and 2 * shift_x >= beyond_px:
                sound = min(sound, difference)
            if difference < least:
                least, best_x, best_y = difference, 2 * shift_x, 2 * shift_y
    mean = total / count
    if mean == 0.0:
        return best_x, best_y, 1.0, 1.0
    return best_x, best_y, least / mean, least / sound if sound > 0.0 else 1.0
