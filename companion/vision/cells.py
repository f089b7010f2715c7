"""A coarse map of λ: the image in cells, each with the mean disparity of what it shows.

The paper's conclusion proposes a dense estimate instead of one scalar; this many cells are enough
to tell which side is freer, and few enough for every frame.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import kernel

Floats32 = NDArray[np.float32]
CellMap = NDArray[np.float32]
"""λ in pixels of each cell, (ROWS, COLUMNS)."""

ROWS, COLUMNS = 6, 8
CELLS = ROWS * COLUMNS
LEAST_VALID_NORM = 0.15
"""A cell with fewer matches has no label."""


class CellLabels(NamedTuple):
    """Of each cell, (ROWS, COLUMNS): mean disparity, NaN where unknown, and share of matches."""

    disparity_px: Floats32
    valid_norm: Floats32


def cell_labels(map_px: Floats32) -> CellLabels:
    """Labels from a disparity map (height, width), NaN where unmatched."""
    disparity_px = np.empty((ROWS, COLUMNS), dtype=np.float32)
    valid_norm = np.empty((ROWS, COLUMNS), dtype=np.float32)
    _label(np.ascontiguousarray(map_px), disparity_px, valid_norm)
    return CellLabels(disparity_px, valid_norm)


def freer_side(map_px: Floats32) -> int:
    """+1 where the right half is farther, -1 where the left half is, 0 where neither is known.

    map_px: (any, columns), NaN where unknown; unknown cells do not count.
    """
    middle = map_px.shape[1] // 2
    left, right = map_px[:, :middle], map_px[:, -middle:]
    if np.isnan(left).all() or np.isnan(right).all():
        return 0
    return 1 if np.nanmean(right) <= np.nanmean(left) else -1


# The signature is given so that it is compiled, or read from the cache, before take-off.
@kernel("void(f4[:,::1], f4[:,::1], f4[:,::1])")
def _label(map_px: CellMap, disparity_px: CellMap, valid_norm: CellMap) -> None:
    height, width = map_px.shape
    rows, columns = disparity_px.shape
    for row in range(rows):
        top, bottom = row * height // rows, (row + 1) * height // rows
        for column in range(columns):
            left, right = column * width // columns, (column + 1) * width // columns
            total, n_valid = 0.0, 0
            for y in range(top, bottom):
                for x in range(left, right):
                    if not np.isnan(map_px[y, x]):
                        total += map_px[y, x]
                        n_valid += 1
            share = n_valid / max((bottom - top) * (right - left), 1)
            valid_norm[row, column] = share
            known = share >= LEAST_VALID_NORM
            disparity_px[row, column] = total / n_valid if known and n_valid > 0 else np.nan
