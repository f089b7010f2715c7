"""Return to launch: up, back, down, land; to home or to the nearest rally point."""

import math
from collections.abc import Callable, Sequence

from companion.kernel.frames import Vector3
from sitl.autopilot.control import Goal
from sitl.autopilot.interface import Estimate
from sitl.autopilot.modes import GoTo, Land, Mode
from sitl.autopilot.parameters import Number


class Return(Mode):
    """PX4's direct return (RTL_TYPE 0).

    Heights are above home: RTL_RETURN_ALT unless it is higher already, then RTL_DESCEND_ALT over
    the place for RTL_LAND_DELAY seconds, for ever if that is negative.
    """

    def __init__(
        self,
        estimate: Estimate,
        places_ned_m: Sequence[Vector3],
        speed_m_s: Callable[[], float],
        parameters: dict[str, Number],
    ) -> None:
        """``places_ned_m`` holds home first and the rally points; the nearest is taken."""
        here = estimate.position_ned_m
        self._parameters = parameters
        self._speed_m_s = speed_m_s
        self._place = min(places_ned_m, key=lambda place: math.dist(place[:2], here[:2]))
        self._waits_since_s = math.nan
        down_m = min(here[2], places_ned_m[0][2] - parameters["RTL_RETURN_ALT"])
        north_m, east_m, _ = self._place
        climb = GoTo((here[0], here[1], down_m), speed_m_s, estimate.yaw_rad)
        back = GoTo((north_m, east_m, down_m), speed_m_s)
        near = back.level_distance_m(estimate) < parameters["NAV_ACC_RAD"]
        self._legs: list[GoTo] = [self._descent()] if near else [climb, back, self._descent()]
        self._landing = Land(parameters, self._place)

    def _descent(self) -> GoTo:
        down_m = self._place[2] - self._parameters["RTL_DESCEND_ALT"]
        return GoTo((self._place[0], self._place[1], down_m), self._speed_m_s)

    @property
    def leg(self) -> Mode:
        return self._legs[0] if self._legs else self._landing

    def goal(self, estimate: Estimate) -> Goal:
        if self._legs and self._reached(self._legs[0], estimate) and self._waited(estimate):
            del self._legs[0]
        return self.leg.goal(estimate)

    def _reached(self, leg: GoTo, estimate: Estimate) -> bool:
        parameters = self._parameters
        return (
            leg.level_distance_m(estimate) < parameters["NAV_ACC_RAD"]
            and leg.height_error_m(estimate) < parameters["NAV_MC_ALT_RAD"]
        )

    def _waited(self, estimate: Estimate) -> bool:
        """Over the place, for as long as RTL_LAND_DELAY says; nowhere else."""
        if len(self._legs) > 1:
            return True
        if math.isnan(self._waits_since_s):
            self._waits_since_s = estimate.time_s
        delay_s = self._parameters["RTL_LAND_DELAY"]
        return 0.0 <= delay_s <= estimate.time_s - self._waits_since_s
