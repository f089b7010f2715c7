"""State of charge and voltage of a lithium-polymer pack."""

from typing import Final

from sitl.autopilot.parameters import Number
from sitl.failures import Failures, Unit
from sitl.settings import BatterySettings

# Open-circuit voltage of a cell over its state of charge: typical lithium-polymer discharge curve.
_CHARGE_NORM: Final = (0.0, 0.05, 0.1, 0.2, 0.5, 0.8, 1.0)
_CELL_V: Final = (3.20, 3.50, 3.62, 3.70, 3.80, 3.98, 4.18)
# 12 min of flight from 1 Ah at 0.42 kg (Parrot) is 5 A, of which the boards draw 0.4 A; the power
# of a rotor grows with its thrust to 3/2 (momentum theory), and 0.42 kg are 0.507 of the greatest.
_BOARDS_A: Final = 0.4
_ROTOR_A: Final = 4.6 / 4.0 / 0.507**1.5


class Battery:
    """BAT1_R_INTERNAL is of the whole pack with its cable."""

    def __init__(
        self, settings: BatterySettings, parameters: dict[str, Number], failures: Failures
    ) -> None:
        self._parameters = parameters
        self._failures = failures
        self._capacity_as = settings.capacity_mah * 3.6
        self._left_norm = settings.charge_norm
        self.current_a = _BOARDS_A
        self.voltage_v = 0.0
        self.update((0.0, 0.0, 0.0, 0.0), 0.0)

    @property
    def charge_norm(self) -> float:
        """State of charge; a battery that fails is empty at once, as in PX4's simulator."""
        return self._left_norm if self._failures.works(Unit.BATTERY) else 0.0

    @charge_norm.setter
    def charge_norm(self, charge_norm: float) -> None:
        self._left_norm = charge_norm

    @property
    def enough_to_arm(self) -> bool:
        """By COM_ARM_BAT_MIN; if that is negative, by the critical level."""
        minimum = self._parameters["COM_ARM_BAT_MIN"]
        return self.charge_norm > (minimum if minimum >= 0.0 else self._parameters["BAT_CRIT_THR"])

    def update(self, motors_norm: tuple[float, float, float, float], step_s: float) -> None:
        """Draws what rotors at these shares of their greatest thrust need for ``step_s``."""
        a, b, c, d = motors_norm
        rotors = a * a**0.5 + b * b**0.5 + c * c**0.5 + d * d**0.5
        self.current_a = _BOARDS_A + _ROTOR_A * rotors
        drained = self.current_a * step_s / self._capacity_as
        least = min(self._left_norm, self._parameters["SIM_BAT_MIN_PCT"] * 0.01)
        self._left_norm = max(least, self._left_norm - drained)
        self.voltage_v = (
            self._parameters["BAT1_N_CELLS"] * _open_circuit_v(self.charge_norm)
            - self.current_a * self._parameters["BAT1_R_INTERNAL"]
        )


def _open_circuit_v(charge_norm: float) -> float:
    """Of one cell, between the points of the curve."""
    for index in range(1, len(_CHARGE_NORM)):
        upper = _CHARGE_NORM[index]
        if charge_norm <= upper:
            lower = _CHARGE_NORM[index - 1]
            share = (charge_norm - lower) / (upper - lower)
            return _CELL_V[index - 1] + share * (_CELL_V[index] - _CELL_V[index - 1])
    return _CELL_V[-1]
