"""What came over the links last, and how long ago."""

import math
from collections.abc import Callable, Mapping
from typing import Final

from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import AttitudeSetpoint, ManualInput, OffboardSetpoint
from sitl.autopilot.parameters import Number
from sitl.autopilot.sticks import StickMotion

CENTRED = ManualInput(0.0, 0.0, 0.0, 0.0)
_OVERRIDE_BITS: Final[Mapping[FlightMode, int]] = {
    FlightMode.TAKEOFF: 1,
    FlightMode.HOLD: 1,
    FlightMode.MISSION: 1,
    FlightMode.RTL: 1,
    FlightMode.LAND: 1,
    FlightMode.OFFBOARD: 2,
}
"""Of COM_RC_OVERRIDE: the modes that a pilot may leave by moving the sticks."""
_WITHOUT_JOYSTICK: Final = {0, 4}
"""Values of COM_RC_IN_MODE under which MANUAL_CONTROL is not listened to: radio only, nothing."""


class Inputs:
    """Ages are in seconds of ``now_s``, and infinite for what never came."""

    def __init__(self, parameters: dict[str, Number], now_s: Callable[[], float]) -> None:
        self._parameters = parameters
        self._now_s = now_s
        self.forget()

    def forget(self) -> None:
        """As if nothing had come yet."""
        self.setpoint: OffboardSetpoint | AttitudeSetpoint = OffboardSetpoint()
        """What offboard mode flies."""
        self.sticks = CENTRED
        self._motion = StickMotion()
        self._setpoint_s = self._sticks_s = self._ground_station_s = -math.inf

    def take_setpoint(self, setpoint: OffboardSetpoint | AttitudeSetpoint) -> None:
        self.setpoint, self._setpoint_s = setpoint, self._now_s()

    def take_sticks(self, sticks: ManualInput) -> None:
        if self._parameters["COM_RC_IN_MODE"] in _WITHOUT_JOYSTICK:
            return
        if self.sticks_lost:
            self._motion = StickMotion()
        self.sticks, self._sticks_s = sticks, self._now_s()
        self._motion.update(sticks, self._sticks_s)

    def hear_ground_station(self) -> None:
        self._ground_station_s = self._now_s()

    @property
    def by_attitude(self) -> bool:
        """Whether the setpoint is one of attitude."""
        return isinstance(self.setpoint, AttitudeSetpoint)

    @property
    def setpoint_age_s(self) -> float:
        return self._now_s() - self._setpoint_s

    @property
    def sticks_age_s(self) -> float:
        return self._now_s() - self._sticks_s

    @property
    def ground_station_age_s(self) -> float:
        return self._now_s() - self._ground_station_s

    @property
    def setpoints_lost(self) -> bool:
        return self.setpoint_age_s > self._parameters["COM_OF_LOSS_T"]

    @property
    def sticks_lost(self) -> bool:
        return self.sticks_age_s > self._parameters["COM_RC_LOSS_T"]

    def pilot_takes(self, mode: FlightMode) -> bool:
        """Whether sticks were just moved so far (COM_RC_STICK_OV) that this mode gives way."""
        moved_percent = 100.0 * self._motion.largest_norm
        if self.sticks_lost or moved_percent <= self._parameters["COM_RC_STICK_OV"]:
            return False
        return bool(int(self._parameters["COM_RC_OVERRIDE"]) & _OVERRIDE_BITS.get(mode, 0))

    @property
    def ground_station_lost(self) -> bool:
        return self.ground_station_age_s > self._parameters["COM_DL_LOSS_T"]
