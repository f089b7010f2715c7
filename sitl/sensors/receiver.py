"""A satellite receiver: five fixes a second while there are satellites, drawn for the flight."""

from typing import Final, NamedTuple

import numpy as np

from companion.kernel.frames import Vector3
from sitl.airframe import AirframeState
from sitl.autopilot.parameters import Number

PERIOD_S: Final = 0.2
# Of a consumer part under an open sky. Slow errors of some metres are left out: they would be
# those of home as well.
_NOISE_M: Final = 0.4
_NOISE_M_S: Final = 0.05
_LEAST_SATELLITES: Final = 4
_EARLY_S: Final = 1e-6  # times are added up in floating point


class Fix(NamedTuple):
    time_s: float
    position_ned_m: Vector3
    velocity_ned_m_s: Vector3
    satellites: int


class Receiver:
    """``fix`` is the newest, None without any."""

    def __init__(self, parameters: dict[str, Number], rng: np.random.Generator) -> None:
        self._parameters = parameters
        self._rng = rng
        self.fix: Fix | None = None

    def update(self, truth: AirframeState) -> Fix | None:
        """A new fix when one is due."""
        parameters = self._parameters
        if not parameters["SYS_HAS_GPS"] or parameters["SIM_GPS_USED"] < _LEAST_SATELLITES:
            self.fix = None
            return None
        if self.fix is not None and truth.time_s - self.fix.time_s < PERIOD_S - _EARLY_S:
            return None
        self.fix = Fix(
            truth.time_s,
            self._noisy(truth.position_ned_m, _NOISE_M),
            self._noisy(truth.velocity_ned_m_s, _NOISE_M_S),
            int(parameters["SIM_GPS_USED"]),
        )
        return self.fix

    def _noisy(self, vector: Vector3, deviation: float) -> Vector3:
        x, y, z = (deviation * self._rng.standard_normal(3)).tolist()
        return vector[0] + x, vector[1] + y, vector[2] + z
