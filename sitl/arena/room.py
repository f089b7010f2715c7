"""Rooms: what a TOML file says about walls, furniture and posters, as checked geometry.

In the file, places are (north, east, height) in metres from the centre of the floor. In here they
are NED with the same origin, so the floor is at 0 and the ceiling at minus the room's height.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from companion.kernel.errors import PlanError
from companion.kernel.frames import Vector3
from companion.kernel.settings import Settings, convert_settings, read_toml
from sitl.arena.textures import check_texture, is_picture_file

Positive = Annotated[float, Meta(gt=0.0)]
Norm = Annotated[float, Meta(ge=0.0, le=1.0)]
SurfaceName = Literal["north", "east", "south", "west", "floor", "ceiling"]


class SurfaceSettings(Settings, frozen=True):
    """``texture`` is a pattern, a PNG beside the room file, or ``photo:NAME``."""

    texture: str = "plywood_tape"
    illumination: Positive = 1.0
    """Factor on the light that this surface gets."""
    repeat_m: Positive | None = None
    """Width of one copy of a picture; without it the picture is stretched over the surface."""


class SurfacesSettings(Settings, frozen=True):
    north: SurfaceSettings = SurfaceSettings()
    east: SurfaceSettings = SurfaceSettings()
    south: SurfaceSettings = SurfaceSettings()
    west: SurfaceSettings = SurfaceSettings()
    floor: SurfaceSettings = SurfaceSettings(texture="concrete")
    ceiling: SurfaceSettings = SurfaceSettings(texture="paint")


class PosterSettings(Settings, frozen=True):
    """Something flat on a wall, the floor or the ceiling: posters, doors, windows, carpets."""

    wall: SurfaceName
    texture: str
    centre_m: tuple[float, float]
    """(along, height): along is east on the north and south walls, north on the east and west
    walls. On floor and ceiling (north, east)."""
    size_m: tuple[Positive, Positive]
    """(width, height); on floor and ceiling (north, east)."""
    illumination: Positive = 1.0


class BoxSettings(Settings, frozen=True):
    """A block whose sides are parallel to the walls; sizes along north, east, height."""

    centre_m: Vector3
    size_m: tuple[Positive, Positive, Positive]
    texture: str = "wood"
    illumination: Positive = 1.0


class CylinderSettings(Settings, frozen=True):
    """An upright pillar; ``bottom_m`` is the height of its foot above the floor."""

    centre_m: tuple[float, float]
    radius_m: Positive
    height_m: Positive
    bottom_m: float = 0.0
    texture: str = "paint"
    illumination: Positive = 1.0


class StartSettings(Settings, frozen=True):
    """Where the vehicle stands before take-off, on the floor."""

    position_m: tuple[float, float] = (0.0, 0.0)
    yaw_deg: float = 0.0


class LightSettings(Settings, frozen=True):
    """One lamp whose light falls off with distance and slant, and light from everywhere."""

    lamp_m: Vector3 | None = None
    """None: in the middle, 0.2 m below the ceiling."""
    ambient_norm: Norm = 0.7
    """Share of the light that does not come from the lamp."""


class RoomSettings(Settings, frozen=True):
    size_m: tuple[Positive, Positive, Positive]
    seed: Annotated[int, Meta(ge=0)] = 1
    """Of everything painted in this room; the same seed paints the same room."""
    texel_m: Annotated[float, Meta(ge=0.001, le=0.2)] = 0.004
    """Size of the finest detail that is painted."""
    start: StartSettings = StartSettings()
    light: LightSettings = LightSettings()
    surface: SurfacesSettings = SurfacesSettings()
    poster: tuple[PosterSettings, ...] = ()
    box: tuple[BoxSettings, ...] = ()
    cylinder: tuple[CylinderSettings, ...] = ()


class Room(NamedTuple):
    """A room as the simulator needs it, in NED from the centre of its floor.

    bounds_ned_m: (2, 3), lowest and highest corner. boxes_ned_m: (n, 6), lowest corner then
    highest. cylinders_ned_m: (n, 5), north and east of the axis, radius, down of top and of foot.
    """

    source: Path
    settings: RoomSettings
    bounds_ned_m: NDArray[np.float64]
    boxes_ned_m: NDArray[np.float64]
    cylinders_ned_m: NDArray[np.float64]

    @property
    def start_position_ned_m(self) -> Vector3:
        north_m, east_m = self.settings.start.position_m
        return north_m, east_m, 0.0

    @property
    def start_yaw_rad(self) -> float:
        return math.radians(self.settings.start.yaw_deg)


def load_room(path: Path) -> Room:
    """The room in a TOML file. Raises PlanError naming the file, the key and what is allowed."""
    settings = convert_settings(read_toml(path), RoomSettings, str(path))
    try:
        return build_room(settings, path)
    except PlanError as error:
        raise PlanError(f"{path}: {error}") from error


def build_room(settings: RoomSettings, source: Path) -> Room:
    """Geometry of ``settings``; pictures are looked for beside ``source``.

    Raises PlanError naming the key.
    """
    _check(settings, source.parent)
    north_m, east_m, height_m = settings.size_m
    half = np.array([north_m / 2, east_m / 2, 0.0])
    bounds = np.array([-half - (0.0, 0.0, height_m), half])
    boxes = [_box_ned(box) for box in settings.box]
    cylinders = [
        (*c.centre_m, c.radius_m, -c.bottom_m - c.height_m, -c.bottom_m) for c in settings.cylinder
    ]
    return Room(
        source=source,
        settings=settings,
        bounds_ned_m=bounds,
        boxes_ned_m=np.array(boxes, np.float64).reshape(-1, 6),
        cylinders_ned_m=np.array(cylinders, np.float64).reshape(-1, 5),
    )


def poster_limits_m(settings: RoomSettings, wall: SurfaceName) -> tuple[float, float, float, float]:
    """(lowest along, lowest height, highest along, highest height) of a poster on ``wall``."""
    north_m, east_m, height_m = settings.size_m
    if wall in ("floor", "ceiling"):
        return -north_m / 2, -east_m / 2, north_m / 2, east_m / 2
    width_m = east_m if wall in ("north", "south") else north_m
    return -width_m / 2, 0.0, width_m / 2, height_m


def picture_names(settings: RoomSettings) -> list[str]:
    """The PNG files that the room shows, relative to its own; photographs of others not."""
    names = {texture for _, texture in _textures(settings)}
    return sorted(name for name in names if is_picture_file(name))


def _box_ned(box: BoxSettings) -> list[float]:
    north_m, east_m, height_m = box.centre_m
    centre = np.array([north_m, east_m, -height_m])
    half = np.array(box.size_m) / 2
    return [*(centre - half), *(centre + half)]


def _check(settings: RoomSettings, folder: Path) -> None:
    for key, texture in _textures(settings):
        check_texture(texture, key, folder)
    _check_inside(settings)
    north_m, east_m, _ = settings.size_m
    for value_m, limit_m in zip(settings.start.position_m, (north_m / 2, east_m / 2), strict=True):
        _within("start.position_m", value_m, value_m, -limit_m, limit_m)


def _textures(settings: RoomSettings) -> Iterator[tuple[str, str]]:
    for name in settings.surface.__struct_fields__:
        yield f"surface.{name}.texture", getattr(settings.surface, name).texture
    for kind in ("poster", "box", "cylinder"):
        for index, item in enumerate(getattr(settings, kind)):
            yield f"{kind}[{index}].texture", item.texture


def _check_inside(settings: RoomSettings) -> None:
    north_m, east_m, height_m = settings.size_m
    for index, poster in enumerate(settings.poster):
        limits = poster_limits_m(settings, poster.wall)
        for axis in range(2):
            half = poster.size_m[axis] / 2
            low, high = poster.centre_m[axis] - half, poster.centre_m[axis] + half
            _within(f"poster[{index}]", low, high, limits[axis], limits[axis + 2])
    lowest, highest = (-north_m / 2, -east_m / 2, 0.0), (north_m / 2, east_m / 2, height_m)
    for index, box in enumerate(settings.box):
        for axis in range(3):
            half = box.size_m[axis] / 2
            low, high = box.centre_m[axis] - half, box.centre_m[axis] + half
            _within(f"box[{index}]", low, high, lowest[axis], highest[axis])
    for index, cylinder in enumerate(settings.cylinder):
        for axis in range(2):
            low = cylinder.centre_m[axis] - cylinder.radius_m
            high = cylinder.centre_m[axis] + cylinder.radius_m
            _within(f"cylinder[{index}]", low, high, lowest[axis], highest[axis])
        top_m = cylinder.bottom_m + cylinder.height_m
        _within(f"cylinder[{index}]", cylinder.bottom_m, top_m, 0.0, height_m)


def _within(key: str, low_m: float, high_m: float, lowest_m: float, highest_m: float) -> None:
    slack_m = 1e-6
    if low_m < lowest_m - slack_m or high_m > highest_m + slack_m:
        raise PlanError(
            f"{key}: reaches from {low_m:g} to {high_m:g} m, "
            f"but the room only from {lowest_m:g} to {highest_m:g} m"
        )
