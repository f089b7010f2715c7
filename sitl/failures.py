"""Units that can fail, and how: what MAV_CMD_INJECT_FAILURE and the faults of a plan choose from.

Numbers are MAVLink's FAILURE_UNIT and FAILURE_TYPE.
"""

from collections.abc import Mapping
from enum import IntEnum
from typing import Final


class Unit(IntEnum):
    GYRO = 0
    ACCELEROMETER = 1
    MAGNETOMETER = 2
    BAROMETER = 3
    GPS = 4
    OPTICAL_FLOW = 5
    VISION = 6
    """External vision, as it comes over a link."""
    RANGE_FINDER = 7
    AIRSPEED = 8
    BATTERY = 100
    MOTOR = 101
    SERVO = 102
    CAMERA = 103
    """The stereo pair; MAVLink's nearest unit is the system that avoids obstacles with it."""
    STICKS = 104
    LINK = 105


class Kind(IntEnum):
    OK = 0
    OFF = 1
    STUCK = 2
    """Tells the same for ever."""
    GARBAGE = 3
    WRONG = 4
    SLOW = 5
    DELAYED = 6
    INTERMITTENT = 7


MOTORS: Final = 4
SOUND: Final = (1.0, 1.0, 1.0, 1.0)
WEAK_NORM: Final = 0.75  # of its thrust is left of a motor that has become slow

_SENSOR: Final = frozenset((Kind.OK, Kind.OFF, Kind.STUCK, Kind.GARBAGE))
_SWITCHED: Final = frozenset((Kind.OK, Kind.OFF))
SUPPORTED: Final[Mapping[Unit, frozenset[Kind]]] = {
    Unit.MAGNETOMETER: _SENSOR,
    Unit.BAROMETER: _SENSOR,
    Unit.GPS: _SENSOR,
    Unit.OPTICAL_FLOW: _SENSOR,
    Unit.VISION: _SWITCHED,
    Unit.RANGE_FINDER: _SENSOR,
    Unit.BATTERY: _SWITCHED,
    Unit.MOTOR: _SWITCHED | {Kind.SLOW},
    Unit.CAMERA: _SENSOR,
    Unit.STICKS: _SWITCHED,
}
"""Gyroscope and accelerometer are missing: nothing flies without them."""


class Failures:
    """What is broken now; whoever reads a unit asks here."""

    def __init__(self) -> None:
        self._kinds: dict[Unit, Kind] = {}
        self.none = True
        """Whether all units work; motors are told apart."""
        self.motor_efficiency_norm: tuple[float, float, float, float] = SOUND
        """Thrust that each rotor still makes, over that of a sound one; in PX4's order."""

    def of(self, unit: Unit) -> Kind:
        return self._kinds.get(unit, Kind.OK)

    def works(self, unit: Unit) -> bool:
        return unit not in self._kinds

    def inject(self, unit: int, kind: int, instance: int = 0) -> bool:
        """False, and no change, for what cannot be simulated. Instance 0 means all."""
        possible = SUPPORTED[Unit(unit)] if unit in SUPPORTED else frozenset()
        if kind not in possible or not 0 <= instance <= MOTORS:
            return False
        if unit == Unit.MOTOR:
            self._inject_motor(Kind(kind), instance)
        elif instance > 1:
            return False
        elif kind == Kind.OK:
            self._kinds.pop(Unit(unit), None)
        else:
            self._kinds[Unit(unit)] = Kind(kind)
        self.none = not self._kinds
        return True

    def _inject_motor(self, kind: Kind, instance: int) -> None:
        left_norm = {Kind.OFF: 0.0, Kind.SLOW: WEAK_NORM}.get(kind, 1.0)
        a, b, c, d = (
            left_norm if instance in (0, number) else now_norm
            for number, now_norm in enumerate(self.motor_efficiency_norm, start=1)
        )
        self.motor_efficiency_norm = a, b, c, d
