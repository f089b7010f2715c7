"""What the autopilot does by itself when something is missing, empty or out of bounds.

Actions that PX4 offers but this vehicle cannot fly indoors fall back: without a remote control
there is no position, altitude or manual mode, and without satellites no way home, so each of them
lands.
"""

import math
from enum import IntEnum
from typing import Final, NamedTuple

from companion.kernel.frames import Vector3
from companion.kernel.messages import FlightMode
from sitl.autopilot.parameters import Number


class Action(IntEnum):
    """In order of severity: the worst of several is taken."""

    NONE = 0
    WARN = 1
    HOLD = 2
    LAND = 3
    TERMINATE = 4


ACTION_MODES: Final = {Action.HOLD: FlightMode.HOLD, Action.LAND: FlightMode.LAND}

# COM_OBL_RC_ACT: position, altitude, manual, return, land, hold, terminate, disarm.
_OFFBOARD_LOSS: Final = (
    *(Action.LAND,) * 5,
    Action.HOLD,
    Action.TERMINATE,
    Action.TERMINATE,
)
# GF_ACTION: none, warning, hold, return, terminate, land.
_GEOFENCE: Final = (
    Action.NONE,
    Action.WARN,
    Action.HOLD,
    Action.LAND,
    Action.TERMINATE,
    Action.LAND,
)
# COM_LOW_BAT_ACT at the critical level: warning, return, land, return.
_BATTERY_CRITICAL: Final = (Action.WARN, Action.LAND, Action.LAND, Action.LAND)


class Situation(NamedTuple):
    """What the failsafes look at; only asked for while flying."""

    in_offboard: bool
    setpoint_age_s: float
    battery_norm: float
    position_ned_m: Vector3
    upright: bool


class Failsafe:
    """Watches one flight. ``causes`` names what is wrong, ``action`` what is done about it."""

    def __init__(self, parameters: dict[str, Number]) -> None:
        self._parameters = parameters
        self.reset()

    def reset(self) -> None:
        """To be called when disarmed."""
        self.action = Action.NONE
        self.causes: dict[str, Action] = {}
        self._outside = False
        self._fence_overruled = False

    @property
    def active(self) -> bool:
        return self.action > Action.WARN

    def overrule(self) -> None:
        """A mode was commanded: whoever did so has the vehicle back, though outside the fence."""
        self._fence_overruled = self._outside

    def update(self, now: Situation) -> list[str]:
        """Judges the situation; returns the causes that are new."""
        before = self.causes
        self.causes = {text: act for text, act in self._judge(now) if act is not Action.NONE}
        self.action = max(self.causes.values(), default=Action.NONE)
        return [text for text in self.causes if text not in before]

    def _judge(self, now: Situation) -> list[tuple[str, Action]]:
        found = []
        if now.in_offboard and now.setpoint_age_s > self._parameters["COM_OF_LOSS_T"]:
            act = _OFFBOARD_LOSS[int(self._parameters["COM_OBL_RC_ACT"])]
            found.append(("No offboard setpoints", act))
        found.extend(self._judge_battery(now.battery_norm))
        self._outside = self._beyond_fence(now.position_ned_m)
        self._fence_overruled = self._fence_overruled and self._outside
        if self._outside and not self._fence_overruled:
            found.append(("Geofence exceeded", _GEOFENCE[int(self._parameters["GF_ACTION"])]))
        if not now.upright:
            found.append(("Attitude failure detected", Action.TERMINATE))
        return found

    def _judge_battery(self, charge_norm: float) -> list[tuple[str, Action]]:
        parameters = self._parameters
        act = _BATTERY_CRITICAL[int(parameters["COM_LOW_BAT_ACT"])]
        if charge_norm <= parameters["BAT_EMERGEN_THR"]:
            return [("Dangerous battery level", act)]
        if charge_norm <= parameters["BAT_CRIT_THR"]:
            return [("Critical battery level", act)]
        if charge_norm <= parameters["BAT_LOW_THR"]:
            return [("Low battery level", Action.WARN)]
        return []

    def _beyond_fence(self, position_ned_m: Vector3) -> bool:
        """PX4's cylinder around home; a size of 0 is no limit."""
        north, east, down = position_ned_m
        level_m = self._parameters["GF_MAX_HOR_DIST"]
        height_m = self._parameters["GF_MAX_VER_DIST"]
        return 0.0 < level_m < math.hypot(north, east) or 0.0 < height_m < -down
