"""What one look at one image tells: light, old rows, empty rows, contrast by cell."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import kernel

Grey = NDArray[np.uint8]
Floats = NDArray[np.float64]

BLACK_LSB = 16
WHITE_LSB = 250
CELL_ROWS, CELL_COLUMNS = 3, 4
STEP_PX = 2
"""Contrast is the difference of neighbouring blocks this wide: less of it is noise, and defocus
shows in it long before the coarse shapes go."""


class Survey(NamedTuple):
    """Figures of one image; shares are 0..1 of its pixels or rows."""

    black_norm: float
    white_norm: float
    stale_norm: float
    """Rows that are the last image's, byte by byte: noise makes that impossible while it works."""
    flat_norm: float
    """Rows of one single value."""
    contrast_lsb: Floats
    """(CELL_ROWS, CELL_COLUMNS): mean difference of neighbouring blocks, of both directions."""

    @property
    def mean_contrast_lsb(self) -> float:
        return float(self.contrast_lsb.mean())


def survey(image: Grey, previous: Grey | None) -> Survey:
    """``image`` (height, width) beside the one before it."""
    before = image[:0] if previous is None or previous.shape != image.shape else previous
    contrast = np.zeros((CELL_ROWS, CELL_COLUMNS))
    n_black, n_white, n_stale, n_flat = _count(image, before, contrast)
    height, width = image.shape
    return Survey(
        black_norm=n_black / (height * width),
        white_norm=n_white / (height * width),
        stale_norm=n_stale / height,
        flat_norm=n_flat / height,
        contrast_lsb=contrast,
    )


@kernel(fast=True)
def _cell_contrast(image: Grey, cell_row: int, cell_column: int) -> float:
    height, width = image.shape
    top, bottom = cell_row * height // CELL_ROWS, (cell_row + 1) * height // CELL_ROWS
    left, right = cell_column * width // CELL_COLUMNS, (cell_column + 1) * width // CELL_COLUMNS
    total, count = 0, 0
    for row in range(top, bottom - 2 * STEP_PX + 1, STEP_PX):
        for column in range(left, right - 2 * STEP_PX + 1, STEP_PX):
            here = beside = below = 0
            for i in range(STEP_PX):
                for j in range(STEP_PX):
                    here += int(image[row + i, column + j])
                    beside += int(image[row + i, column + STEP_PX + j])
                    below += int(image[row + STEP_PX + i, column + j])
            total += abs(beside - here) + abs(below - here)
            count += 2
    return total / (count * STEP_PX * STEP_PX) if count else 0.0


@kernel("UniTuple(i8, 4)(u1[:,::1], u1[:,::1], f8[:,::1])", fast=True)
def _count(image: Grey, before: Grey, contrast: Floats) -> tuple[int, int, int, int]:
    """(black pixels, white pixels, stale rows, flat rows); fills ``contrast``."""
    height, width = image.shape
    n_black = n_white = n_stale = n_flat = 0
    for row in range(height):
        darkest, brightest, changes = np.uint8(255), np.uint8(0), 0
        for column in range(width):
            value = image[row, column]
            n_black += value < BLACK_LSB
            n_white += value >= WHITE_LSB
            darkest, brightest = min(darkest, value), max(brightest, value)
        if before.shape[0] > 0:
            for column in range(width):
                changes += before[row, column] != image[row, column]
            n_stale += changes == 0
        n_flat += darkest == brightest
    for cell_row in range(CELL_ROWS):
        for cell_column in range(CELL_COLUMNS):
            contrast[cell_row, cell_column] = _cell_contrast(image, cell_row, cell_column)
    return n_black, n_white, n_stale, n_flat
