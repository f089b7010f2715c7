"""Where the vehicle may be: the areas of an uploaded fence, on the level."""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

LevelPoint: TypeAlias = tuple[float, float]
"""North and east of the local origin, m."""


class Circle(NamedTuple):
    centre_m: LevelPoint
    radius_m: float
    inclusion: bool

    def contains(self, point_m: LevelPoint) -> bool:
        return math.dist(self.centre_m, point_m) <= self.radius_m


class Polygon(NamedTuple):
    vertices_m: tuple[LevelPoint, ...]
    inclusion: bool

    def contains(self, point_m: LevelPoint) -> bool:
        """By the even-odd rule: a ray to the north crosses the outline an odd number of times."""
        north_m, east_m = point_m
        inside = False
        a_north, a_east = self.vertices_m[-1]
        for b_north, b_east in self.vertices_m:
            if (a_east > east_m) != (b_east > east_m):
                share = (east_m - a_east) / (b_east - a_east)
                inside ^= north_m < a_north + share * (b_north - a_north)
            a_north, a_east = b_north, b_east
        return inside


Area: TypeAlias = Circle | Polygon


def allowed(areas: Sequence[Area], point_m: LevelPoint) -> bool:
    """Inside at least one inclusion, if there are any, and inside no exclusion."""
    inclusions = [area for area in areas if area.inclusion]
    if inclusions and not any(area.contains(point_m) for area in inclusions):
        return False
    return not any(area.contains(point_m) for area in areas if not area.inclusion)
