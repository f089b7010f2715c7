"""Torn images: from some row on all is shifted sideways, because the start of a line was lost."""

import numpy as np
from numpy.typing import NDArray

from companion.compiled import kernel

Grey = NDArray[np.uint8]

BANDS_PER_IMAGE = 6
"""The uppermost and the lowest of them are compared."""
BIN_PX = 4
"""Columns are added up by as many for that."""
TURN_PX = 24
"""An image and the one before are apart sideways by no more, either way: 90 degrees per second at
10 Hz are 18 px with a lens of 117 px. Where all of an image has moved by more, nothing is torn."""
NEAREST_PX = 48
"""The eyes' images are apart by no more, one way: the disparity of what the hull touches."""
BETWEEN_EYES_NORM = 0.9
"""A band that fits so much better beyond the reach than within it is apart; sound eyes show 2."""
BETWEEN_IMAGES_NORM = 0.7
"""The same for an eye and its last image: sound ones show 0.9 and more."""
SEAM_RATIO = 0.8
"""Step between two rows over the image's usual one, beyond the other eye's there: a seam."""
LEAST_SEAM_RATIO = 0.25
"""Below it there is none, and the eyes do not fit for another reason."""
SEAM_ROWS = 5
"""How near the edge must be in the other eye: more than a poor calibration is off."""


def apart_between_eyes(left: Grey, right: Grey) -> bool:
    """Whether two eyes fit at one end only: disparity moves things one way."""
    return _fit_at_one_end(left, right, (NEAREST_PX, BIN_PX), BETWEEN_EYES_NORM)


def apart_from_last(image: Grey, last: Grey | None) -> bool:
    """Whether an image fits the one before it at one end only."""
    if last is None or last.shape != image.shape:
        return False
    return _fit_at_one_end(image, last, (TURN_PX, TURN_PX), BETWEEN_IMAGES_NORM)


def seams(left: Grey, right: Grey) -> tuple[float, float]:
    """How much the largest step between two rows of each eye exceeds the other eye's there.

    In units of the usual step; the edges of a scene are in both eyes.
    """
    steps = [_steps(image) for image in (left, right)]
    return _excess(steps[0], steps[1]), _excess(steps[1], steps[0])


def _steps(image: Grey) -> NDArray[np.float64]:
    """(height - 1,): mean difference of each row to the one above, over the median."""
    steps = np.abs(np.diff(image.astype(np.float64), axis=0)).mean(axis=1)
    return np.asarray(steps / max(float(np.median(steps)), 1.0))


def _excess(own: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    padded = np.pad(other, SEAM_ROWS, mode="edge")
    nearby = np.lib.stride_tricks.sliding_window_view(padded, 2 * SEAM_ROWS + 1).max(axis=1)
    return float((own - nearby).max())


def _fit_at_one_end(image: Grey, other: Grey, reach_px: tuple[int, int], limit_norm: float) -> bool:
    band = len(image) // BANDS_PER_IMAGE
    upper = _fit_norm(image[:band], other[:band], *reach_px)
    lower = _fit_norm(image[len(image) - band :], other[len(image) - band :], *reach_px)
    return bool((upper < limit_norm) != (lower < limit_norm))


@kernel("f8(u1[:,::1], u1[:,::1], i8, i8)", fast=True)
def _fit_norm(band: Grey, other: Grey, reach_px: int, back_px: int) -> float:
    """Least difference of the bands when shifted beyond the reach, over the least within it.

    The reach is ``reach_px`` to the right and ``back_px`` to the left; shifts go round.
    """
    height, width = other.shape[0], other.shape[1] // BIN_PX
    now = np.zeros((height, 2 * width), np.int32)
    then = np.zeros((height, width), np.int32)
    for row in range(height):
        for column in range(width):
            for i in range(BIN_PX):
                now[row, column] += band[row, BIN_PX * column + i]
                then[row, column] += other[row, BIN_PX * column + i]
            now[row, width + column] = now[row, column]
    within = beyond = -1
    for shift in range(width):
        total = 0
        for row in range(height):
            for column in range(width):
                total += abs(now[row, column + shift] - then[row, column])
        if shift * BIN_PX <= reach_px or (width - shift) * BIN_PX <= back_px:
            within = total if within < 0 else min(within, total)
        else:
            beyond = total if beyond < 0 else min(beyond, total)
    return beyond / within if beyond >= 0 and within > 0 else np.inf
