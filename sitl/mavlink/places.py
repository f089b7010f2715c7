"""Places on Earth as places from home."""

import math

from sitl.mavlink.motion import METRES_PER_DEGREE
from sitl.mavlink.snapshot import HOME_LATITUDE_DEG, HOME_LONGITUDE_DEG


def level_from_degrees(latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """North and east of home, m; the inverse of what GLOBAL_POSITION_INT tells."""
    metres_per_degree_east = METRES_PER_DEGREE * math.cos(math.radians(HOME_LATITUDE_DEG))
    return (
        (latitude_deg - HOME_LATITUDE_DEG) * METRES_PER_DEGREE,
        (longitude_deg - HOME_LONGITUDE_DEG) * metres_per_degree_east,
    )
