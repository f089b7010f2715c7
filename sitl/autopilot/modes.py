"""Flight modes: each turns an estimate into a goal, and remembers what it holds on to."""

import math
from collections.abc import Callable
from typing import Final, Protocol

from companion.kernel.frames import Vector3
from companion.kernel.messages import NAN
from sitl.autopilot.control import Goal
from sitl.autopilot.interface import NAN3, Estimate, OffboardSetpoint
from sitl.autopilot.parameters import Number

_STOPPED_M_S: Final = 0.1  # slower than this, a position can be held
_REACHED_M: Final = 0.1
_STEADY_M_S: Final = 0.2
_NOSE_AHEAD_M: Final = 0.5  # closer than this the direction to a place means little


class Mode(Protocol):
    def goal(self, estimate: Estimate) -> Goal: ...


class _Anchor:
    """Brakes first, then holds on to where it came to rest."""

    def __init__(self, position_ned_m: Vector3 = NAN3) -> None:
        self._level = position_ned_m[0], position_ned_m[1]
        self._down = position_ned_m[2]

    def level(self, estimate: Estimate) -> tuple[float, float]:
        """(north, east) to hold; NaN while braking."""
        if self._level[0] != self._level[0]:
            north_m_s, east_m_s, _ = estimate.velocity_ned_m_s
            if math.hypot(north_m_s, east_m_s) < _STOPPED_M_S:
                self._level = estimate.position_ned_m[0], estimate.position_ned_m[1]
        return self._level

    def down(self, estimate: Estimate) -> float:
        """Height to hold (down, so negative above home); NaN while braking."""
        if self._down != self._down and abs(estimate.velocity_ned_m_s[2]) < _STOPPED_M_S:
            self._down = estimate.position_ned_m[2]
        return self._down

    def release_down(self) -> None:
        self._down = NAN


class Hold:
    """Hovers at ``position_ned_m``, or where the vehicle comes to rest on axes of NaN."""

    def __init__(self, position_ned_m: Vector3 = NAN3) -> None:
        self._anchor = _Anchor(position_ned_m)

    def goal(self, estimate: Estimate) -> Goal:
        north, east = self._anchor.level(estimate)
        return Goal((north, east, self._anchor.down(estimate)))


class GoTo:
    """Flies to a place and stays there, nose ahead on the way unless a heading is given.

    Axes of NaN hold where the vehicle comes to rest.
    """

    def __init__(
        self, position_ned_m: Vector3, speed_m_s: Callable[[], float], yaw_rad: float = NAN
    ) -> None:
        self._anchor = _Anchor(position_ned_m)
        self._speed_m_s = speed_m_s
        self._yaw_rad = yaw_rad
        self._ahead = yaw_rad != yaw_rad

    def goal(self, estimate: Estimate) -> Goal:
        north, east = self._anchor.level(estimate)
        d_north = north - estimate.position_ned_m[0]
        d_east = east - estimate.position_ned_m[1]
        if self._ahead and math.hypot(d_north, d_east) > _NOSE_AHEAD_M:
            self._yaw_rad = math.atan2(d_east, d_north)
        return Goal(
            (north, east, self._anchor.down(estimate)),
            yaw_rad=self._yaw_rad,
            level_limit_m_s=self._speed_m_s(),
        )


class TakeOff:
    """Straight up from where it was entered."""

    def __init__(self, estimate: Estimate, height_m: float, parameters: dict[str, Number]) -> None:
        north_m, east_m, self._start_down_m = estimate.position_ned_m
        self._target: Vector3 = (north_m, east_m, -height_m)
        self._parameters = parameters
        self.low = True
        """Whether less than half of the way up lies behind."""
        self.done = False

    def goal(self, estimate: Estimate) -> Goal:
        missing_m = estimate.position_ned_m[2] - self._target[2]
        climbed_m = self._start_down_m - estimate.position_ned_m[2]
        self.low = climbed_m < missing_m
        steady = abs(estimate.velocity_ned_m_s[2]) < _STEADY_M_S
        self.done = self.done or (steady and abs(missing_m) < _REACHED_M)
        return Goal(self._target, climb_limit_m_s=self._parameters["MPC_TKO_SPEED"])


class Land:
    """Straight down from where it came to rest, at landing speed until the ground is felt."""

    def __init__(self, parameters: dict[str, Number]) -> None:
        self._anchor = _Anchor()
        self._parameters = parameters

    def goal(self, estimate: Estimate) -> Goal:
        north, east = self._anchor.level(estimate)
        return Goal((north, east, NAN), (0.0, 0.0, self._parameters["MPC_LAND_SPEED"]))


class Offboard:
    """Flies the newest setpoint.

    A vertical speed of exactly 0 holds the height at which the vehicle came to rest: PX4 steers by
    speed alone and lets the height wander.
    """

    def __init__(self, setpoint: OffboardSetpoint) -> None:
        self.setpoint = setpoint
        self._anchor = _Anchor()

    def goal(self, estimate: Estimate) -> Goal:
        setpoint = self.setpoint
        north, east, down = setpoint.position_ned_m
        v_north, v_east, v_down = (0.0 if v != v else v for v in setpoint.velocity_ned_m_s)
        if down != down and v_down == 0.0:
            down = self._anchor.down(estimate)
        else:
            self._anchor.release_down()
        return Goal(
            (north, east, down),
            (v_north, v_east, v_down),
            setpoint.yaw_rad,
            setpoint.yaw_rate_rad_s,
        )

    def wants_up(self, estimate: Estimate) -> bool:
        """Whether the setpoint leads off the ground."""
        down_m, v_down_m_s = self.setpoint.position_ned_m[2], self.setpoint.velocity_ned_m_s[2]
        return v_down_m_s < -0.05 or down_m < estimate.position_ned_m[2] - _REACHED_M
