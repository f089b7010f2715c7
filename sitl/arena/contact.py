"""How near a point is to what the vehicle could hit."""

import math

import numpy as np
from numpy.typing import NDArray

from companion.kernel.frames import Vector3
from sitl.arena.jit import kernel
from sitl.arena.room import Room

Floats = NDArray[np.float64]
Contact = tuple[float, float, float, float]
"""Distance, then the normal's north, east, down."""


class RoomContact:
    """Walls, ceiling, boxes and pillars of a room; the floor is left to the landing gear."""

    def __init__(self, room: Room) -> None:
        self._arrays = (room.bounds_ned_m, room.boxes_ned_m, room.cylinders_ned_m)
        self.nearest((0.0, 0.0, 0.0))  # compiles the kernel before anything flies

    def nearest(self, position_ned_m: Vector3) -> tuple[float, Vector3]:
        """(distance to the nearest surface in metres, unit NED normal from it to the point).

        Negative inside a thing or beyond a wall; the normal then shows the shortest way out.
        """
        north, east, down = position_ned_m
        distance_m, *normal = _nearest(*self._arrays, north, east, down)
        return distance_m, (normal[0], normal[1], normal[2])


@kernel
def _nearest(
    bounds: Floats, boxes: Floats, cylinders: Floats, x: float, y: float, z: float
) -> Contact:
    best = _from_walls(bounds, x, y, z)
    for k in range(boxes.shape[0]):
        found = _from_box(boxes[k], x, y, z)
        if found[0] < best[0]:
            best = found
    for k in range(cylinders.shape[0]):
        found = _from_cylinder(cylinders[k], x, y, z)
        if found[0] < best[0]:
            best = found
    return best


@kernel
def _from_walls(bounds: Floats, x: float, y: float, z: float) -> Contact:
    best = (bounds[1, 0] - x, -1.0, 0.0, 0.0)
    if bounds[1, 1] - y < best[0]:
        best = (bounds[1, 1] - y, 0.0, -1.0, 0.0)
    if x - bounds[0, 0] < best[0]:
        best = (x - bounds[0, 0], 1.0, 0.0, 0.0)
    if y - bounds[0, 1] < best[0]:
        best = (y - bounds[0, 1], 0.0, 1.0, 0.0)
    if z - bounds[0, 2] < best[0]:
        best = (z - bounds[0, 2], 0.0, 0.0, 1.0)
    return best


@kernel
def _from_box(box: Floats, x: float, y: float, z: float) -> Contact:
    """Each axis says how far outside the box the point is (negative: inside), and to which side."""
    ax, sx = _outside(box[0], box[3], x)
    ay, sy = _outside(box[1], box[4], y)
    az, sz = _outside(box[2], box[5], z)
    deepest = max(ax, ay, az)
    if deepest <= 0.0:
        if ax == deepest:
            return ax, sx, 0.0, 0.0
        if ay == deepest:
            return ay, 0.0, sy, 0.0
        return az, 0.0, 0.0, sz
    ax, ay, az = max(ax, 0.0), max(ay, 0.0), max(az, 0.0)
    distance = math.sqrt(ax * ax + ay * ay + az * az)
    return distance, sx * ax / distance, sy * ay / distance, sz * az / distance


@kernel
def _from_cylinder(cylinder: Floats, x: float, y: float, z: float) -> Contact:
    from_axis_x, from_axis_y = x - cylinder[0], y - cylinder[1]
    arm = math.sqrt(from_axis_x * from_axis_x + from_axis_y * from_axis_y)
    # On the axis every way out is as short; north is one.
    nx, ny = (from_axis_x / arm, from_axis_y / arm) if arm > 0.0 else (1.0, 0.0)
    beside = arm - cylinder[2]
    above, side = _outside(cylinder[3], cylinder[4], z)
    if max(beside, above) <= 0.0:
        if beside >= above:
            return beside, nx, ny, 0.0
        return above, 0.0, 0.0, side
    beside, above = max(beside, 0.0), max(above, 0.0)
    distance = math.sqrt(beside * beside + above * above)
    return distance, nx * beside / distance, ny * beside / distance, side * above / distance


@kernel
def _outside(low: float, high: float, value: float) -> tuple[float, float]:
    """(distance beyond the nearer end of an interval, the side of that end: -1 or 1)."""
    if low - value > value - high:
        return low - value, -1.0
    return value - high, 1.0
