"""Orbit: around a place at a radius and a speed, as PX4's orbit mode flies it."""

import math
from enum import IntEnum
from typing import Final

from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import NAN
from sitl.autopilot.control import Goal
from sitl.autopilot.interface import Estimate, OrbitRequest, OrbitStatus
from sitl.autopilot.modes import GoTo, Mode
from sitl.autopilot.parameters import Number

_SMALLEST_M: Final = 1.0
_CENTRIPETAL_M_S2: Final = 2.0  # PX4's greatest: a tighter circle is flown slower
_ON_CIRCLE_M: Final = 0.3  # PX4 takes 2 m, outdoors
_RADIAL_1_S: Final = 1.0  # speed towards the circle per metre off it, as PX4
_LAG_S: Final = 0.3  # from a wanted velocity to the flown one; aimed ahead by as much


class YawBehaviour(IntEnum):
    """MAVLink's ORBIT_YAW_BEHAVIOUR; what is not here keeps the heading as it is."""

    TO_CENTRE = 0
    INITIAL_HEADING = 1
    UNCONTROLLED = 2
    ALONG_CIRCLE = 3


class Orbit(Mode):
    """Straight to the nearest point of the circle first, then round and round."""

    def __init__(self, estimate: Estimate, parameters: dict[str, Number]) -> None:
        """Around where it is, until a request says more."""
        self._parameters = parameters
        self._centre_ned_m = estimate.position_ned_m
        self._radius_m, self._speed_m_s, self._sense = _SMALLEST_M, 1.0, 1.0
        self._yaw_behaviour = int(parameters["MC_ORBIT_YAW_MOD"])
        self._initial_yaw_rad = estimate.yaw_rad
        self._approach: GoTo | None = None

    def take(self, request: OrbitRequest, estimate: Estimate) -> None:
        """A request that changes nothing does not disturb the orbit."""
        parameters, before = self._parameters, self.status
        if not math.isnan(request.radius_m):
            self._sense = math.copysign(1.0, request.radius_m)
            largest_m = parameters["MC_ORBIT_RAD_MAX"]
            self._radius_m = max(_SMALLEST_M, min(largest_m, abs(request.radius_m)))
        if not math.isnan(request.speed_m_s):
            self._speed_m_s = abs(request.speed_m_s)
        if 0 <= request.yaw_behaviour <= YawBehaviour.ALONG_CIRCLE:
            self._yaw_behaviour = request.yaw_behaviour
            self._initial_yaw_rad = estimate.yaw_rad
        given = zip(request.centre_ned_m, self._centre_ned_m, strict=True)
        north_m, east_m, down_m = (old if math.isnan(new) else new for new, old in given)
        self._centre_ned_m = north_m, east_m, down_m
        if self.status != before or self._approach is None:
            self._approach = self._way_to_circle(estimate)

    @property
    def status(self) -> OrbitStatus:
        return OrbitStatus(self._sense * self._radius_m, self._centre_ned_m)

    def goal(self, estimate: Estimate) -> Goal:
        approach = self._approach
        if approach is not None and approach.level_distance_m(estimate) > _ON_CIRCLE_M:
            return approach.goal(estimate)
        self._approach = None
        return self._circle(estimate)

    def _way_to_circle(self, estimate: Estimate) -> GoTo:
        north_m, east_m, _ = self._centre_ned_m
        angle_rad, _ = self._polar(estimate)
        point = (
            north_m + self._radius_m * math.cos(angle_rad),
            east_m + self._radius_m * math.sin(angle_rad),
            self._centre_ned_m[2],
        )
        return GoTo(point, lambda: self._parameters["MPC_XY_CRUISE"])

    def _polar(self, estimate: Estimate) -> tuple[float, float]:
        """Direction from the centre to the vehicle, and their level distance."""
        north_m = estimate.position_ned_m[0] - self._centre_ned_m[0]
        east_m = estimate.position_ned_m[1] - self._centre_ned_m[1]
        return math.atan2(east_m, north_m), math.hypot(north_m, east_m)

    def _circle(self, estimate: Estimate) -> Goal:
        angle_rad, distance_m = self._polar(estimate)
        fastest_m_s = math.sqrt(_CENTRIPETAL_M_S2 * self._radius_m)
        speed_m_s = self._sense * min(
            self._speed_m_s, fastest_m_s, self._parameters["MPC_XY_VEL_MAX"]
        )
        rate_rad_s = speed_m_s / self._radius_m
        ahead_rad = angle_rad + rate_rad_s * _LAG_S
        outward_m_s = _RADIAL_1_S * (self._radius_m - distance_m)
        yaw_rad, yaw_rate_rad_s = self._heading(angle_rad, rate_rad_s)
        return Goal(
            (NAN, NAN, self._centre_ned_m[2]),
            (
                outward_m_s * math.cos(angle_rad) - speed_m_s * math.sin(ahead_rad),
                outward_m_s * math.sin(angle_rad) + speed_m_s * math.cos(ahead_rad),
                0.0,
            ),
            yaw_rad,
            yaw_rate_rad_s,
        )

    def _heading(self, angle_rad: float, rate_rad_s: float) -> tuple[float, float]:
        """(heading, rate of its change)."""
        if self._yaw_behaviour == YawBehaviour.TO_CENTRE:
            return wrap_angle_rad(angle_rad + math.pi), rate_rad_s
        if self._yaw_behaviour == YawBehaviour.ALONG_CIRCLE:
            return wrap_angle_rad(angle_rad + self._sense * math.pi / 2), rate_rad_s
        fixed = self._yaw_behaviour == YawBehaviour.INITIAL_HEADING
        return (self._initial_yaw_rad if fixed else NAN), NAN
