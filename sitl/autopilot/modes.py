"""Flight modes: each turns an estimate into a goal, and remembers what it holds on to."""

import math
from collections.abc import Callable
from typing import Final

from companion.kernel.frames import Vector3
from companion.kernel.messages import NAN
from sitl.autopilot.control import Goal
from sitl.autopilot.interface import NAN3, Estimate, OffboardSetpoint
from sitl.autopilot.parameters import Number

_STOPPED_M_S: Final = 0.1  # slower than this, a position can be held
_REACHED_M: Final = 0.1
_STEADY_M_S: Final = 0.2
_UP_M_S2: Final = 0.05  # an acceleration that is meant to leave the ground
_NOSE_AHEAD_M: Final = 0.5  # closer than this the direction to a place means little


class Mode:
    """Base of all modes; no ABC, whose isinstance() is slow and asked at every step."""

    def goal(self, estimate: Estimate) -> Goal:
        """What to fly now; asked for at every step in the air."""
        raise NotImplementedError  # every mode has its own

    @property
    def leg(self) -> "Mode":
        """The part that is being flown, of a mode that is made of others."""
        return self

    def stand(self, estimate: Estimate) -> None:
        """Called instead of ``goal`` while standing on the ground."""
        del estimate  # most modes only wait there


class Anchor:
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

    def release_level(self) -> None:
        self._level = NAN, NAN

    def release_down(self) -> None:
        self._down = NAN


class Hold(Mode):
    """Hovers at ``position_ned_m``, or where the vehicle comes to rest on axes of NaN."""

    def __init__(self, position_ned_m: Vector3 = NAN3) -> None:
        self._anchor = Anchor(position_ned_m)

    def goal(self, estimate: Estimate) -> Goal:
        north, east = self._anchor.level(estimate)
        return Goal((north, east, self._anchor.down(estimate)))


class GoTo(Mode):
    """Flies to a place and stays there, nose ahead on the way unless a heading is given.

    Axes of NaN hold where the vehicle comes to rest.
    """

    def __init__(
        self, position_ned_m: Vector3, speed_m_s: Callable[[], float], yaw_rad: float = NAN
    ) -> None:
        self.position_ned_m = position_ned_m
        self._speed_m_s = speed_m_s
        self._yaw_rad = yaw_rad
        self._ahead = yaw_rad != yaw_rad
        self._anchor = Anchor(position_ned_m)

    def goal(self, estimate: Estimate) -> Goal:
        north, east = self._anchor.level(estimate)
        if self._ahead and self.level_distance_m(estimate) > _NOSE_AHEAD_M:
            here = estimate.position_ned_m
            self._yaw_rad = math.atan2(east - here[1], north - here[0])
        return Goal(
            (north, east, self._anchor.down(estimate)),
            yaw_rad=self._yaw_rad,
            level_limit_m_s=self._speed_m_s(),
        )

    def level_distance_m(self, estimate: Estimate) -> float:
        """To the place; 0 where none was given."""
        north, east, _ = self.position_ned_m
        distance_m = math.dist((north, east), estimate.position_ned_m[:2])
        return 0.0 if distance_m != distance_m else distance_m

    def height_error_m(self, estimate: Estimate) -> float:
        missing_m = abs(self.position_ned_m[2] - estimate.position_ned_m[2])
        return 0.0 if missing_m != missing_m else missing_m


class TakeOff(Mode):
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


class Land(Mode):
    """Straight down, at landing speed until the ground is felt.

    Onto the level place of ``position_ned_m``, or where the vehicle comes to rest.
    """

    def __init__(self, parameters: dict[str, Number], position_ned_m: Vector3 = NAN3) -> None:
        self._anchor = Anchor(position_ned_m)
        self._parameters = parameters

    def goal(self, estimate: Estimate) -> Goal:
        north, east = self._anchor.level(estimate)
        return Goal((north, east, NAN), (0.0, 0.0, self._parameters["MPC_LAND_SPEED"]))


class Descend(Land):
    """Down at landing speed where nobody knows the place: level, as the wind was trimmed out."""

    def goal(self, estimate: Estimate) -> Goal:
        return Goal(NAN3, (NAN, NAN, self._parameters["MPC_LAND_SPEED"]))


class Offboard(Mode):
    """Flies the newest setpoint. An axis with nothing but an acceleration is steered by that.

    A vertical speed of exactly 0 holds the height at which the vehicle came to rest: PX4 steers by
    speed alone and lets the height wander.
    """

    def __init__(self, setpoint: OffboardSetpoint) -> None:
        self.setpoint = setpoint
        self._anchor = Anchor()

    def goal(self, estimate: Estimate) -> Goal:
        setpoint = self.setpoint
        north, east, down = setpoint.position_ned_m
        velocity = setpoint.velocity_ned_m_s
        acceleration = setpoint.acceleration_ned_m_s2
        pushed = tuple(
            place != place and speed != speed and force == force
            for place, speed, force in zip(
                setpoint.position_ned_m, velocity, acceleration, strict=True
            )
        )
        v_north, v_east, v_down = (
            NAN if push else _number(speed) for push, speed in zip(pushed, velocity, strict=True)
        )
        if down != down and v_down == 0.0:
            down = self._anchor.down(estimate)
        else:
            self._anchor.release_down()
        a_north, a_east, a_down = map(_number, acceleration)
        return Goal(
            (north, east, down),
            (v_north, v_east, v_down),
            setpoint.yaw_rad,
            setpoint.yaw_rate_rad_s,
            acceleration_ned_m_s2=(a_north, a_east, a_down),
        )

    def wants_up(self, estimate: Estimate) -> bool:
        """Whether the setpoint leads off the ground."""
        down_m, v_down_m_s = self.setpoint.position_ned_m[2], self.setpoint.velocity_ned_m_s[2]
        pushed_up = self.setpoint.acceleration_ned_m_s2[2] < -_UP_M_S2
        return pushed_up or v_down_m_s < -0.05 or down_m < estimate.position_ned_m[2] - _REACHED_M


def _number(value: float) -> float:
    """0 for NaN."""
    return 0.0 if value != value else value
