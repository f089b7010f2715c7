"""How much the airframe shakes, by PX4's measure: the mean change from one sample to the next."""

import math
from typing import Final

from companion.kernel.frames import Vector3
from sitl.autopilot.interface import Estimate

_KEEP: Final = 0.99  # of the mean at each sample, as PX4


class Vibration:
    """``update`` is to be called at a steady rate."""

    def __init__(self) -> None:
        self._before: Estimate | None = None
        self.gyro_rad_s = 0.0
        self.acceleration_m_s2 = 0.0

    def update(self, estimate: Estimate) -> None:
        before, self._before = self._before, estimate
        if before is None:
            return
        self.gyro_rad_s = _mean(self.gyro_rad_s, before.rates_frd_rad_s, estimate.rates_frd_rad_s)
        self.acceleration_m_s2 = _mean(
            self.acceleration_m_s2, before.acceleration_frd_m_s2, estimate.acceleration_frd_m_s2
        )


def _mean(mean: float, before: Vector3, now: Vector3) -> float:
    return _KEEP * mean + (1.0 - _KEEP) * math.dist(before, now)
