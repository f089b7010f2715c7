"""What was uploaded to the autopilot: mission, fence and rally points."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from companion.kernel.frames import Vector3
from sitl.autopilot.geofence import Area, allowed
from sitl.autopilot.home import Home
from sitl.autopilot.mission import (
    Jump,
    LandAt,
    Mission,
    MissionItem,
    TakeOffTo,
    Waypoint,
)
from sitl.autopilot.parameters import Number


class Problem(NamedTuple):
    """Why an item cannot be flown."""

    item: int
    text: str


class Plans:
    def __init__(self, parameters: dict[str, Number], home: Home) -> None:
        self._parameters = parameters
        self.home = home
        self.mission = Mission()
        self.fence: tuple[Area, ...] = ()
        self.rally_ned_m: tuple[Vector3, ...] = ()

    def inside_fence(self, position_ned_m: Vector3) -> bool:
        """Of the uploaded fence and of PX4's cylinder around home; a size of 0 is no limit."""
        north_m, east_m, down_m = self.home.offset_ned_m(position_ned_m)
        level_m = self._parameters["GF_MAX_HOR_DIST"]
        height_m = self._parameters["GF_MAX_VER_DIST"]
        too_far = 0.0 < level_m < math.hypot(north_m, east_m) or 0.0 < height_m < -down_m
        return not too_far and allowed(self.fence, position_ned_m[:2])

    def problem(self, items: Sequence[MissionItem]) -> Problem | None:
        """The first reason why these items cannot be flown; None if they can."""
        located = False
        for number, item in enumerate(items):
            if isinstance(item, Jump):
                if not 0 <= item.target < len(items) or isinstance(items[item.target], Jump):
                    return Problem(number, f"no item to jump to: {item.target}")
            elif isinstance(item, Waypoint | TakeOffTo | LandAt):
                text = self._place_problem(item, located)
                if text is not None:
                    return Problem(number, text)
                located = located or not math.isnan(item.position_ned_m[0])
        return None

    def _place_problem(self, item: Waypoint | TakeOffTo | LandAt, located: bool) -> str | None:
        north_m, east_m, down_m = item.position_ned_m
        flown = not isinstance(item, LandAt)
        home_down_m = self.home.position_ned_m[2]
        if flown and down_m > home_down_m:
            return "below home"
        if math.isnan(north_m):
            return None
        distance_m = math.dist((north_m, east_m), self.home.position_ned_m[:2])
        if not located and 0.0 < self._parameters["MIS_DIST_1WP"] < distance_m:
            return f"first place is {distance_m:.0f} m away"
        if not self.inside_fence((north_m, east_m, down_m if flown else home_down_m)):
            return "outside the geofence"
        return None
