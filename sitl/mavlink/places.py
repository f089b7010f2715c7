"""Places on Earth and in the vehicle's local frame."""

import math
from typing import Final

from companion.kernel.frames import Vector3
from sitl.mavlink.snapshot import HOME_LATITUDE_DEG, HOME_LONGITUDE_DEG

METRES_PER_DEGREE: Final = 111_319.5
"""Along a meridian, or along the equator; a room is too small for the difference to matter."""
_METRES_PER_DEGREE_EAST: Final = METRES_PER_DEGREE * math.cos(math.radians(HOME_LATITUDE_DEG))


def degrees_from_ned(position_ned_m: Vector3) -> tuple[float, float]:
    """(latitude, longitude)."""
    north_m, east_m, _ = position_ned_m
    return (
        HOME_LATITUDE_DEG + north_m / METRES_PER_DEGREE,
        HOME_LONGITUDE_DEG + east_m / _METRES_PER_DEGREE_EAST,
    )


def level_from_degrees(latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """(north, east) in metres; NaN stays NaN."""
    return (
        (latitude_deg - HOME_LATITUDE_DEG) * METRES_PER_DEGREE,
        (longitude_deg - HOME_LONGITUDE_DEG) * _METRES_PER_DEGREE_EAST,
    )
