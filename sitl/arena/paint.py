"""Brushes for textures: noise with the spectrum of natural scenes, strips, discs, mirror tiles.

An image is float32 reflectance of shape (rows, columns), columns to the right, rows down. Places
and sizes on it are metres from its upper left corner: ``u`` right, ``v`` down.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


class Sheet(NamedTuple):
    """Size of an image: texels, and metres per texel."""

    rows: int
    columns: int
    texel_m: float

    @property
    def width_m(self) -> float:
        return self.columns * self.texel_m

    @property
    def height_m(self) -> float:
        return self.rows * self.texel_m

    def filled(self, reflectance: float) -> Image:
        return np.full((self.rows, self.columns), reflectance, np.float32)

    def point_m(self, rng: np.random.Generator) -> tuple[float, float]:
        """(u, v) of a place anywhere on the sheet."""
        return rng.uniform(0, self.width_m), rng.uniform(0, self.height_m)


def noise(
    sheet: Sheet,
    rng: np.random.Generator,
    coarsest_m: float,
    finest_m: float = 0.0,
    stretch: float = 1.0,
) -> Image:
    """Noise with mean 0, deviation 1 and equal power in every octave of wavelengths.

    That is the 1/f amplitude spectrum of natural scenes. ``stretch`` lengthens it along v.
    """
    knot_m = coarsest_m / 2
    last_knot_m = max(finest_m / 2, sheet.texel_m)
    field = rng.standard_normal(_knots(sheet, knot_m, stretch), np.float32)
    while knot_m / 2 >= last_knot_m:
        knot_m /= 2
        finer = rng.standard_normal(_knots(sheet, knot_m, stretch), np.float32)
        field = finer + _enlarged(field, finer.shape, 0.5, 0.5)
    per_knot = sheet.texel_m / knot_m
    image = _enlarged(field, (sheet.rows, sheet.columns), per_knot, per_knot / stretch)
    mean, deviation = cv2.meanStdDev(image)
    return (image - np.float32(mean.item())) / np.float32(max(deviation.item(), 1e-6))


def _knots(sheet: Sheet, knot_m: float, stretch: float) -> tuple[int, int]:
    rows = 2 + math.ceil(sheet.height_m / (knot_m * stretch))
    return rows, 2 + math.ceil(sheet.width_m / knot_m)


def _enlarged(field: Image, shape: tuple[int, ...], step_u: float, step_v: float) -> Image:
    """``field`` read by cubic interpolation every ``step`` of its own texels."""
    place = np.array([[step_u, 0.0, 0.0], [0.0, step_v, 0.0]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    size = (shape[1], shape[0])
    image = cv2.warpAffine(field, place, size, flags=flags, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(image, np.float32)


def polygon(image: Image, sheet: Sheet, corners_m: NDArray[np.float64], reflectance: float) -> None:
    """Paints a filled convex polygon with smooth edges; corners_m: (n, 2) of (u, v)."""
    _fill(image, corners_m / sheet.texel_m, reflectance)


def rectangle(
    image: Image,
    sheet: Sheet,
    upper_left_m: tuple[float, float],
    size_m: tuple[float, float],
    reflectance: float,
) -> None:
    """Paints an upright rectangle; size is (width, height)."""
    (u, v), (width, height) = upper_left_m, size_m
    corners = np.array([(u, v), (u + width, v), (u + width, v + height), (u, v + height)])
    polygon(image, sheet, corners, reflectance)


def strip(
    image: Image,
    sheet: Sheet,
    centre_m: tuple[float, float],
    size_m: tuple[float, float],
    angle_rad: float,
    reflectance: float,
) -> None:
    """Paints a rectangle of (length, width) turned by ``angle_rad`` about its centre."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    half = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * np.array(size_m) / 2
    corners = half @ np.array([(c, s), (-s, c)]) + np.array(centre_m)
    polygon(image, sheet, corners, reflectance)


def disc(
    image: Image, sheet: Sheet, centre_m: tuple[float, float], radius_m: float, reflectance: float
) -> None:
    angles = np.linspace(0, 2 * math.pi, 24, endpoint=False)
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1) * radius_m
    polygon(image, sheet, rim + np.array(centre_m), reflectance)


def _fill(image: Image, corners_texel: NDArray[np.float64], reflectance: float) -> None:
    """Blends inside the polygon's own bounding box, so that small things stay cheap."""
    rows, columns = image.shape
    low = np.maximum(np.floor(corners_texel.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(corners_texel.max(axis=0)).astype(int) + 2, (columns, rows))
    if (high <= low).any():
        return
    mask = np.zeros((high[1] - low[1], high[0] - low[0]), np.uint8)
    shift = 4
    # OpenCV's whole numbers are texel centres.
    fixed = np.round((corners_texel - low - 0.5) * (1 << shift)).astype(np.int32)
    cv2.fillConvexPoly(mask, fixed, 255, cv2.LINE_AA, shift)
    cover = mask.astype(np.float32) / 255
    region = image[low[1] : high[1], low[0] : high[0]]
    region += cover * (np.float32(reflectance) - region)


def mirrored(motif: Image, rows: int, columns: int) -> Image:
    """The motif repeated over (rows, columns), every second copy mirrored, both ways."""
    tall = np.concatenate([motif, motif[::-1]], axis=0)
    tile = np.concatenate([tall, tall[:, ::-1]], axis=1)
    copies = (-(-rows // tile.shape[0]), -(-columns // tile.shape[1]))
    return np.tile(tile, copies)[:rows, :columns]


def in_steps(field: Image, levels: NDArray[np.float32]) -> Image:
    """Noise of unit deviation turned into flat areas, equally many texels at each level."""
    edges = np.quantile(field, np.linspace(0, 1, len(levels) + 1)[1:-1])
    return levels[np.searchsorted(edges, field)].astype(np.float32)
