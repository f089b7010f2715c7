"""All surfaces of a room painted, lit and shrunk into one array that the ray kernel reads.

Surfaces are numbered: the room's north, east, south, west, floor, ceiling; per box its north, east,
south, west, bottom and top face; per cylinder its bottom, top and mantle. Images are stored along
increasing coordinates: columns (``u``) and rows (``v``) run east and down on faces that look north
or south, north and down on those that look east or west, north and east on level ones.
"""

import math
import zlib
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.errors import PlanError
from sitl.arena.paint import Image, Sheet
from sitl.arena.room import BoxSettings, CylinderSettings, PosterSettings, Room, SurfaceSettings
from sitl.arena.textures import paint_texture

Places = NDArray[np.float64]
Material = SurfaceSettings | PosterSettings | BoxSettings | CylinderSettings

LEVELS = 14
"""Each level has 1/sqrt(2) the texels per metre of the one before: too fine a ladder to see."""
ROOM_FACES = ("north", "east", "south", "west", "floor", "ceiling")
FACES = len(ROOM_FACES)
MANTLE = 3
CYLINDER_FACES = 3
FULL_SCALE = 1.5
"""Reflectance times light that a texel of 255 stands for."""
MOST_TEXELS = 30_000_000
"""Some 60 MB at most: the levels take as much again."""
UV_AXES = ((1, 2), (0, 2), (0, 1))
"""Per axis of the normal: the NED axes along which u and v run."""
UV_HANDEDNESS = (1, -1, 1)
"""Whether u x v points along or against that axis."""
LIGHT_CELLS = 24


class Atlas(NamedTuple):
    """Texels and where to find them.

    texels: uint8, flat; FULL_SCALE at 255. start and stride: (surface, level), index of the first
    texel and length of a row, a rim of one repeated texel included. scale: (surface, level, 2),
    texels per metre along u and v. origin_m and size_m: (surface, 2), u and v of the first texel's
    edge in NED (along the arc for a mantle), and the lengths. axis: (surface,), of the normal: 0
    north, 1 east, 2 down, MANTLE for the round one.
    """

    texels: NDArray[np.uint8]
    start: NDArray[np.int32]
    stride: NDArray[np.int32]
    scale: NDArray[np.float32]
    origin_m: NDArray[np.float32]
    size_m: NDArray[np.float32]
    axis: NDArray[np.int32]


@dataclass(frozen=True)
class _Face:
    """A flat surface at ``at_m`` on ``axis`` that looks along (+1) or against (-1) it."""

    key: str
    material: Material
    axis: int
    at_m: float
    looks: int
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]

    @property
    def size_m(self) -> tuple[float, float]:
        width_m, height_m = self.high_m - self.low_m
        return float(width_m), float(height_m)

    @property
    def mirrored(self) -> bool:
        """Whether u runs to the left of someone who looks at the face."""
        return self.looks == UV_HANDEDNESS[self.axis]

    def places(self, fractions: Places) -> tuple[Places, Places]:
        """Points at these (n, n, 2) fractions of the size, and normals, both (n, n, 3) NED."""
        points = np.full((*fractions.shape[:2], 3), self.at_m)
        points[..., UV_AXES[self.axis]] = self.low_m + fractions * (self.high_m - self.low_m)
        normals = np.zeros_like(points)
        normals[..., self.axis] = self.looks
        return points, normals


@dataclass(frozen=True)
class _Mantle:
    """The round side of a cylinder; u is the arc from north over east, v runs down."""

    key: str
    material: Material
    centre_ned_m: tuple[float, float]
    radius_m: float
    top_down_m: float
    foot_down_m: float

    axis: ClassVar[int] = MANTLE
    mirrored: ClassVar[bool] = True

    @property
    def low_m(self) -> NDArray[np.float64]:
        return np.array([0.0, self.top_down_m])

    @property
    def size_m(self) -> tuple[float, float]:
        return 2 * math.pi * self.radius_m, self.foot_down_m - self.top_down_m

    def places(self, fractions: Places) -> tuple[Places, Places]:
        angle_rad = 2 * math.pi * fractions[..., 0]
        normals = np.stack([np.cos(angle_rad), np.sin(angle_rad), 0 * angle_rad], axis=-1)
        down_m = self.top_down_m + fractions[..., 1] * (self.foot_down_m - self.top_down_m)
        points = normals * self.radius_m
        points[..., :2] += self.centre_ned_m
        points[..., 2] = down_m
        return points, normals


def build_atlas(room: Room) -> Atlas:
    """Paints the room. Raises PlanError for one too large, or a picture that cannot be read."""
    surfaces = _surfaces(room)
    _check_size(room, [surface.size_m for surface in surfaces])
    pyramids = [_pyramid(_paint(room, surface)) for surface in surfaces]
    sizes = np.array([surface.size_m for surface in surfaces])
    counts = np.array([[level.size for level in levels] for levels in pyramids])
    shapes = np.array([[level.shape for level in levels] for levels in pyramids])
    ends = np.cumsum(counts.ravel())
    return Atlas(
        texels=np.concatenate([level.ravel() for levels in pyramids for level in levels]),
        start=(ends - counts.ravel()).reshape(counts.shape).astype(np.int32),
        stride=shapes[..., 1].astype(np.int32),
        scale=((shapes[..., ::-1] - 2) / sizes[:, None, :]).astype(np.float32),
        origin_m=np.array([surface.low_m for surface in surfaces], np.float32),
        size_m=sizes.astype(np.float32),
        axis=np.array([surface.axis for surface in surfaces], np.int32),
    )


def _check_size(room: Room, sizes_m: list[tuple[float, float]]) -> None:
    texel_m = room.settings.texel_m
    texels = sum(width_m * height_m for width_m, height_m in sizes_m) / texel_m**2
    if texels > MOST_TEXELS:
        least_m = texel_m * math.sqrt(texels / MOST_TEXELS)
        raise PlanError(
            f"{room.source}: texel_m: {texel_m:g} is too fine for a room of this size; "
            f"allowed: at least {math.ceil(least_m * 1e4) / 1e4:g}"
        )


def _surfaces(room: Room) -> list[_Face | _Mantle]:
    low, high = room.bounds_ned_m
    materials = [getattr(room.settings.surface, name) for name in ROOM_FACES]
    keys = [f"surface.{name}" for name in ROOM_FACES]
    surfaces: list[_Face | _Mantle] = [*_faces(keys, materials, low, high, inside=True)]
    for index, (box, corners) in enumerate(zip(room.settings.box, room.boxes_ned_m, strict=True)):
        keys = [f"box[{index}].{name}" for name in ROOM_FACES]
        surfaces += _faces(keys, [box] * FACES, corners[:3], corners[3:], inside=False)
    rows = zip(room.settings.cylinder, room.cylinders_ned_m, strict=True)
    for index, (cylinder, (north, east, radius, top, foot)) in enumerate(rows):
        key = f"cylinder[{index}]"
        low = np.array([north - radius, east - radius, top])
        high = np.array([north + radius, east + radius, foot])
        surfaces += _faces([key] * FACES, [cylinder] * FACES, low, high, inside=False)[4:]
        surfaces.append(_Mantle(key, cylinder, (north, east), radius, top, foot))
    return surfaces


def _faces(
    keys: list[str],
    materials: list[Material],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    *,
    inside: bool,
) -> list[_Face]:
    """The six faces of a block in the order of ROOM_FACES, seen from inside or from outside."""
    ends = ((0, 1), (1, 1), (0, -1), (1, -1), (2, 1), (2, -1))
    faces = []
    for key, material, (axis, end) in zip(keys, materials, ends, strict=True):
        at_m = float(high[axis] if end > 0 else low[axis])
        uv = list(UV_AXES[axis])
        faces.append(_Face(key, material, axis, at_m, -end if inside else end, low[uv], high[uv]))
    return faces


def _paint(room: Room, surface: _Face | _Mantle) -> Image:
    """Reflectance times light of one surface with all that hangs on it, stored along u and v."""
    image = _material(room, surface.key, surface.material, surface.size_m, surface.mirrored)
    name = surface.key.removeprefix("surface.")
    for index, poster in enumerate(room.settings.poster):
        if poster.wall != name:
            continue
        assert isinstance(surface, _Face)
        along_m, across_m = poster.centre_m
        centre_m = np.array([along_m, across_m if surface.axis == 2 else -across_m])
        key = f"poster[{index}]"
        picture = _material(room, key, poster, poster.size_m, surface.mirrored)
        corner_m = centre_m - np.array(poster.size_m) / 2 - surface.low_m
        column, row = np.maximum(np.round(corner_m / room.settings.texel_m).astype(int), 0)
        target = image[row : row + picture.shape[0], column : column + picture.shape[1]]
        target[:] = picture[: target.shape[0], : target.shape[1]]
    image *= _light(room, surface, image.shape)
    return image


def _material(
    room: Room, key: str, material: Material, size_m: tuple[float, float], mirrored: bool
) -> Image:
    """Each thing is painted from the room's seed and its own key: others do not change it."""
    texel_m = room.settings.texel_m
    columns, rows = (max(1, round(side_m / texel_m)) for side_m in size_m)
    rng = np.random.default_rng([room.settings.seed, zlib.crc32(key.encode())])
    repeat_m = material.repeat_m if isinstance(material, SurfaceSettings) else None
    sheet = Sheet(rows, columns, texel_m)
    image = paint_texture(material.texture, sheet, rng, room.source.parent, repeat_m)
    image *= np.float32(material.illumination)
    return np.ascontiguousarray(image[:, ::-1]) if mirrored else image


def _light(room: Room, surface: _Face | _Mantle, shape: tuple[int, ...]) -> Image:
    """Light on each texel; 1 on the floor right below the lamp."""
    settings = room.settings.light
    lamp = settings.lamp_m or (0.0, 0.0, room.settings.size_m[2] - 0.2)
    steps = (np.arange(LIGHT_CELLS) + 0.5) / LIGHT_CELLS
    fractions = np.stack(np.meshgrid(steps, steps), axis=-1)
    points, normals = surface.places(fractions)
    to_lamp = np.array([lamp[0], lamp[1], -lamp[2]]) - points
    distance_m = np.linalg.norm(to_lamp, axis=-1)
    facing = np.maximum((to_lamp * normals).sum(axis=-1), 0.0) / distance_m
    direct = np.minimum(facing * (lamp[2] / distance_m) ** 2, FULL_SCALE)
    light = settings.ambient_norm + (1.0 - settings.ambient_norm) * direct
    return np.asarray(cv2.resize(light, (shape[1], shape[0])), np.float32)


def _pyramid(image: Image) -> list[NDArray[np.uint8]]:
    """LEVELS sizes of the image, each averaged over areas, with a rim for interpolation."""
    image = image * np.float32(255.0 / FULL_SCALE)
    sizes = [image]
    for level in range(1, LEVELS):
        shrink = 2.0 ** (-level / 2)
        rows, columns = (max(1, round(side * shrink)) for side in image.shape)
        source = sizes[max(level - 2, 0)]
        smaller = cv2.resize(source, (columns, rows), interpolation=cv2.INTER_AREA)
        sizes.append(np.asarray(smaller, np.float32))
    return [
        np.pad(np.clip(np.rint(size), 0, 255).astype(np.uint8), 1, mode="edge") for size in sizes
    ]
