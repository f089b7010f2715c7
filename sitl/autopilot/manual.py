"""Flying by hand: with a place to hold, or with the height alone."""

import math

from companion.kernel.frames import ned_from_hfrd
from companion.kernel.messages import NAN
from sitl.airframe import GRAVITY_M_S2
from sitl.autopilot.control import Goal
from sitl.autopilot.interface import Estimate, ManualInput
from sitl.autopilot.modes import Anchor, Mode
from sitl.autopilot.parameters import Number


class Position(Mode):
    """PX4's position mode: sticks are velocities along the nose; centred they hold the place."""

    def __init__(self, sticks: ManualInput, parameters: dict[str, Number]) -> None:
        self.sticks = sticks
        self._parameters = parameters
        self._anchor = Anchor()

    def goal(self, estimate: Estimate) -> Goal:
        forward, right, up, yaw = (self._beyond_dead_zone(stick) for stick in self.sticks)
        full_m_s = self._parameters["MPC_VEL_MANUAL"]
        v_north, v_east = ned_from_hfrd(full_m_s * forward, full_m_s * right, estimate.yaw_rad)
        if forward or right:
            self._anchor.release_level()
        north, east = (NAN, NAN) if forward or right else self._anchor.level(estimate)
        down, v_down = self._height(up, estimate)
        return Goal(
            (north, east, down),
            (v_north, v_east, v_down),
            yaw_rate_rad_s=yaw * math.radians(self._parameters["MPC_MAN_Y_MAX"]),
        )

    def _height(self, up: float, estimate: Estimate) -> tuple[float, float]:
        """(place, velocity) down: a centred stick holds the height."""
        if up:
            self._anchor.release_down()
            return NAN, -up * self._vertical_limit_m_s(up)
        return self._anchor.down(estimate), 0.0

    @property
    def wants_up(self) -> bool:
        return self._beyond_dead_zone(self.sticks.up_norm) > 0.0

    def _vertical_limit_m_s(self, up: float) -> float:
        name = "MPC_Z_VEL_MAX_UP" if up > 0.0 else "MPC_Z_VEL_MAX_DN"
        return self._parameters[name]

    def _beyond_dead_zone(self, stick_norm: float) -> float:
        """0 around the centre; grows from there to 1 at full deflection."""
        zone_norm = self._parameters["MPC_HOLD_DZ"]
        beyond_norm = max(0.0, abs(stick_norm) - zone_norm) / (1.0 - zone_norm)
        return math.copysign(min(1.0, beyond_norm), stick_norm) if beyond_norm > 0.0 else 0.0


class Altitude(Position):
    """PX4's altitude mode: sticks tilt the vehicle, and nothing stops it but the air."""

    def goal(self, estimate: Estimate) -> Goal:
        forward, right, up, yaw = (self._beyond_dead_zone(stick) for stick in self.sticks)
        full = GRAVITY_M_S2 * math.tan(math.radians(self._parameters["MPC_MAN_TILT_MAX"]))
        a_north, a_east = ned_from_hfrd(full * forward, full * right, estimate.yaw_rad)
        down, v_down = self._height(up, estimate)
        return Goal(
            (NAN, NAN, down),
            (NAN, NAN, v_down),
            yaw_rate_rad_s=yaw * math.radians(self._parameters["MPC_MAN_Y_MAX"]),
            acceleration_ned_m_s2=(a_north, a_east, 0.0),
        )
