"""All surfaces of a room painted, lit and shrunk into one array that the ray kernel reads.

Surfaces are numbered: the room's north, east, south, west, floor, ceiling; then per box its north,
east, south, west, bottom and top face; then per cylinder its mantle, bottom and top.
"""

import math
import zlib
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.errors import PlanError
from sitl.arena.paint import Image, Sheet
from sitl.arena.room import (
    BoxSettings,
    CylinderSettings,
    PosterSettings,
    Room,
    SurfaceSettings,
    poster_limits_m,
)
from sitl.arena.textures import paint_texture

LEVELS = 14
"""Each level is 1/sqrt(2) the size of the one before: so fine a ladder needs no blending."""
MOST_TEXELS = 60_000_000
ROOM_SURFACES = 6
BOX_SURFACES = 6
CYLINDER_SURFACES = 3
WALLS = ("north", "east", "south", "west")
LEVELS_SPAN_PAD = 2


class Face(NamedTuple):
    """A flat rectangle: where its upper left corner is, along which axes its image runs."""

    key: str
    corner_ned_m: NDArray[np.float64]
    right_ned: NDArray[np.float64]
    down_ned: NDArray[np.float64]
    size_m: tuple[float, float]
    mirrored: bool
    """The image is stored along increasing coordinates, so half of the faces are flipped."""

    @property
    def normal_ned(self) -> NDArray[np.float64]:
        return np.cross(self.right_ned, self.down_ned)


class Atlas(NamedTuple):
    """Texels and where to find them.

    texels: uint8, flat, reflectance times light, 255 being ``full_scale``. start, stride: (surface,
    level) index of a level's first texel and length of its rows, both with one texel of rim.
    scale: (surface, level, 2) texels per metre along columns and rows. size: (surface, 2) metres.
    """

    texels: NDArray[np.uint8]
    start: NDArray[np.int32]
    stride: NDArray[np.int32]
    scale: NDArray[np.float32]
    size: NDArray[np.float32]
