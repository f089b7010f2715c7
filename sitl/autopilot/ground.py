"""Feeling the ground: lift-off and touch-down from what the autopilot itself knows."""

from enum import IntEnum
from typing import Final

from sitl.autopilot.interface import Estimate
from sitl.autopilot.parameters import Number

_CLEAR_M: Final = 0.1  # above where the climb began: the feet are off
_DESCENT_WANTED_M_S: Final = 0.35  # asked to sink at least this fast
_LIGHT_NORM: Final = 0.85  # with less lift than this share of the weight
_CONTACT_SHARE: Final = 3 / 8  # of LNDMC_TRIG_TIME the ground is felt; then motors idle on it


class GroundState(IntEnum):
    STANDING = 0
    LIFTING_OFF = 1
    FLYING = 2
    TOUCHING = 3
    """The ground is felt: lift is taken away, to see whether the vehicle stays."""


class GroundDetector:
    """Four states; ``update`` is to be called at a steady rate while armed."""

    def __init__(self, parameters: dict[str, Number], update_hz: int) -> None:
        self._parameters = parameters
        self._step_s = 1.0 / update_hz
        self.state = GroundState.STANDING
        self._start_down_m = 0.0
        self._for_s = 0.0
        self._blocked_s = 0.0

    @property
    def standing(self) -> bool:
        return self.state is GroundState.STANDING

    @property
    def time_in_state_s(self) -> float:
        """Since lift-off began, or since the ground was felt."""
        return self._for_s

    def lift_off(self, estimate: Estimate) -> None:
        """The motors begin to lift."""
        self._enter(GroundState.LIFTING_OFF)
        self._start_down_m = estimate.position_ned_m[2]

    def stand(self) -> None:
        """The motors are off, wherever the vehicle is."""
        self._enter(GroundState.STANDING)

    def update(self, estimate: Estimate, descent_setpoint_m_s: float, lift_norm: float) -> None:
        """``lift_norm`` is the commanded thrust over the weight."""
        self._for_s += self._step_s
        contact_s = self._parameters["LNDMC_TRIG_TIME"] * _CONTACT_SHARE
        if self.state in (GroundState.LIFTING_OFF, GroundState.FLYING):
            blocked = (
                descent_setpoint_m_s > _DESCENT_WANTED_M_S
                and abs(estimate.velocity_ned_m_s[2]) < self._parameters["LNDMC_Z_VEL_MAX"]
                and lift_norm < _LIGHT_NORM
            )
            self._blocked_s = self._blocked_s + self._step_s if blocked else 0.0
            if self._blocked_s >= contact_s:
                self._enter(GroundState.TOUCHING)
            elif self.state is GroundState.LIFTING_OFF and self._climbed(estimate):
                self._enter(GroundState.FLYING)
        elif self.state is GroundState.TOUCHING:
            if estimate.velocity_ned_m_s[2] > _DESCENT_WANTED_M_S:  # it fell: that was no ground
                self._enter(GroundState.FLYING)
            elif self._for_s >= self._parameters["LNDMC_TRIG_TIME"] - contact_s:
                self._enter(GroundState.STANDING)

    def _climbed(self, estimate: Estimate) -> bool:
        return self._start_down_m - estimate.position_ned_m[2] > _CLEAR_M

    def _enter(self, state: GroundState) -> None:
        self.state = state
        self._for_s = self._blocked_s = 0.0
