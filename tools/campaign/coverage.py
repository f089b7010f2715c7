"""How much of a room a vehicle could visit: what its coverage is a share of."""

import itertools
import math

from companion.truth import CELL_M
from sitl.arena.contact import RoomContact
from sitl.arena.room import Room
from sitl.hull import HULL_RADIUS_M

POINTS = 5
"""Looked at along each side of a cell."""


def free_cells(room: Room, height_m: float) -> int:
    """Cells of CELL_M in which the hull's centre can be at this height without touching."""
    contact = RoomContact(room)
    low_m, high_m = room.bounds_ned_m[:, :2]
    norths, easts = (
        range(math.floor(low / CELL_M), math.ceil(high / CELL_M))
        for low, high in zip(low_m, high_m, strict=True)
    )
    cells = itertools.product(norths, easts)
    return sum(_is_free(contact, north, east, height_m) for north, east in cells)


def _is_free(contact: RoomContact, north: int, east: int, height_m: float) -> bool:
    steps = [(step + 0.5) / POINTS for step in range(POINTS)]
    places_m = (
        ((north + part) * CELL_M, (east + other) * CELL_M, -height_m)
        for part, other in itertools.product(steps, steps)
    )
    return any(contact.nearest(place_m)[0] >= HULL_RADIUS_M for place_m in places_m)
