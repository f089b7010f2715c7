"""An image's gradients at three scales, pooled on a coarse grid: features that keep place and size.

A histogram of textons forgets where in the image something was and how large; both tell distance.
Energies are pooled per cell and taken as logarithms, so that contrast and size become sums that a
regressor can weigh. The image is brought to WIDTH_PX x HEIGHT_PX first, whatever the camera.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.compiled import kernel
from companion.vision import cells

Grey = NDArray[np.uint8]
Floats32 = NDArray[np.float32]

WIDTH_PX, HEIGHT_PX = 64, 48
SCALES = 3
"""Full, half and quarter size."""
ROWS, COLUMNS = 3, 4
CELL_SCALES = 2
"""Of the finer cells of a map: at quarter size they would be 2 px wide."""
ENERGIES = 6
"""Across, down, both diagonals, square, and the lesser of across and down (corners)."""
QUANTILES = (0.25, 0.5, 0.75, 0.9, 0.98)
"""Of the gradient's magnitude over the whole image."""
FLOOR_LSB = 2.0
"""Added before the logarithm: about the camera's noise, below which a gradient says nothing."""
BRIGHTNESS_UNIT_LSB = 64.0
BINS_PER_LSB, MOST_LSB = 4, 364
"""Of the counts that the quantiles come from: counting is faster than sorting."""

N_FEATURES = SCALES * (ENERGIES * ROWS * COLUMNS + len(QUANTILES)) + ROWS * COLUMNS


def shrink(image: Grey) -> Floats32:
    """``image`` (height, width) at the size that features are made of."""
    enlarging = image.shape[1] < WIDTH_PX
    method = cv2.INTER_CUBIC if enlarging else cv2.INTER_AREA
    return np.asarray(cv2.resize(image, (WIDTH_PX, HEIGHT_PX), interpolation=method), np.float32)


def encode(view: Floats32) -> Floats32:
    """Features (N_FEATURES,) of a view, (HEIGHT_PX, WIDTH_PX) grey levels."""
    features = np.empty(N_FEATURES, dtype=np.float32)
    _encode(np.ascontiguousarray(view), np.array(QUANTILES), features)
    return features


def encode_cells(view: Floats32) -> Floats32:
    """Features of each cell of a view: (cells.CELLS, CELL_SCALES * ENERGIES + 1)."""
    features = np.empty((cells.CELLS, CELL_SCALES * ENERGIES + 1), dtype=np.float32)
    _encode_cells(np.ascontiguousarray(view), features)
    return features


@kernel()
def _halve(view: Floats32) -> Floats32:
    height, width = view.shape[0] // 2, view.shape[1] // 2
    half = np.empty((height, width), dtype=np.float32)
    for row in range(height):
        for column in range(width):
            top, left = 2 * row, 2 * column
            total = view[top, left] + view[top, left + 1]
            total += view[top + 1, left] + view[top + 1, left + 1]
            half[row, column] = total * np.float32(0.25)
    return half


@kernel(fast=True)
def _pool(view: Floats32, energy: NDArray[np.float64], counts: NDArray[np.int64]) -> None:
    """Mean energies per cell, (ENERGIES, rows, columns), and how often each magnitude occurs."""
    _, rows, columns = energy.shape
    height, width = view.shape[0] // rows, view.shape[1] // columns
    counts[:] = 0
    sums = np.empty(ENERGIES)
    for cell in range(rows * columns):
        top, left = cell // columns * height, cell % columns * width
        sums[:] = 0.0
        for row in range(max(top, 1), min(top + height, view.shape[0] - 1)):
            for column in range(max(left, 1), min(left + width, view.shape[1] - 1)):
                across = view[row, column + 1] - view[row, column - 1]
                down = view[row + 1, column] - view[row - 1, column]
                squared = across * across + down * down
                sums[0] += abs(across)
                sums[1] += abs(down)
                sums[2] += abs(across + down)
                sums[3] += abs(across - down)
                sums[4] += squared
                sums[5] += min(abs(across), abs(down))
                counts[min(int(np.sqrt(squared) * BINS_PER_LSB), len(counts) - 1)] += 1
        energy[:, cell // columns, cell % columns] = sums / (height * width)


@kernel()
def _quantiles(
    counts: NDArray[np.int64], quantiles: NDArray[np.float64], features: Floats32
) -> None:
    """Logarithms of the magnitudes that those shares of the pixels stay below."""
    seen, total, place = 0, counts.sum(), 0
    for bin_ in range(len(counts)):
        seen += counts[bin_]
        while place < len(quantiles) and seen > quantiles[place] * total:
            features[place] = np.log(FLOOR_LSB + bin_ / BINS_PER_LSB)
            place += 1


@kernel()
def _brightness(view: Floats32, features: Floats32) -> None:
    height, width = view.shape[0] // ROWS, view.shape[1] // COLUMNS
    for row in range(ROWS):
        for column in range(COLUMNS):
            top, left = row * height, column * width
            cell = view[top : top + height, left : left + width]
            features[row * COLUMNS + column] = cell.mean() / BRIGHTNESS_UNIT_LSB


# The signature is given so that it is compiled, or read from the cache, before take-off.
@kernel("void(f4[:,::1], f8[::1], f4[::1])")
def _encode(view: Floats32, quantiles: NDArray[np.float64], features: Floats32) -> None:
    energy = np.empty((ENERGIES, ROWS, COLUMNS))
    counts = np.empty(int(MOST_LSB * BINS_PER_LSB), dtype=np.int64)
    n_cells = ROWS * COLUMNS
    _brightness(view, features[-n_cells:])
    place = 0
    for _ in range(SCALES):
        _pool(view, energy, counts)
        for value in energy.reshape(-1):
            features[place] = np.log(FLOOR_LSB + value)
            place += 1
        _quantiles(counts, quantiles, features[place:])
        place += len(quantiles)
        view = _halve(view)


@kernel("void(f4[:,::1], f4[:,::1])")
def _encode_cells(view: Floats32, features: Floats32) -> None:
    energy = np.empty((ENERGIES, cells.ROWS, cells.COLUMNS))
    counts = np.empty(int(MOST_LSB * BINS_PER_LSB), dtype=np.int64)
    height, width = view.shape[0] // cells.ROWS, view.shape[1] // cells.COLUMNS
    for cell in range(len(features)):
        top, left = cell // cells.COLUMNS * height, cell % cells.COLUMNS * width
        brightness = view[top : top + height, left : left + width].mean()
        features[cell, -1] = brightness / BRIGHTNESS_UNIT_LSB
    for scale in range(CELL_SCALES):
        _pool(view, energy, counts)
        for cell in range(len(features)):
            for kind in range(ENERGIES):
                value = energy[kind, cell // cells.COLUMNS, cell % cells.COLUMNS]
                features[cell, scale * ENERGIES + kind] = np.log(FLOOR_LSB + value)
        view = _halve(view)
