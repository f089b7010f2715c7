"""What came over the links last, and how long ago."""

import math
from collections.abc import Callable

from sitl.autopilot.interface import AttitudeSetpoint, ManualInput, OffboardSetpoint
from sitl.autopilot.parameters import Number

CENTRED = ManualInput(0.0, 0.0, 0.0, 0.0)


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
        self._setpoint_s = self._sticks_s = self._ground_station_s = -math.inf

    def take_setpoint(self, setpoint: OffboardSetpoint | AttitudeSetpoint) -> None:
        self.setpoint, self._setpoint_s = setpoint, self._now_s()

    def take_sticks(self, sticks: ManualInput) -> None:
        self.sticks, self._sticks_s = sticks, self._now_s()

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

    @property
    def ground_station_lost(self) -> bool:
        return self.ground_station_age_s > self._parameters["COM_DL_LOSS_T"]
