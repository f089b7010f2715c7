"""The way flown as the autopilot tells it: its velocity summed up over the frames' stamps."""

import numpy as np
from numpy.typing import NDArray

from companion.kernel.messages import Telemetry

Floats = NDArray[np.float64]

LONGEST_GAP_NS = 2_000_000_000
"""Between two frames; what was flown in a longer one is unknown."""


class WayFlown:
    """Since the first frame after it began."""

    def __init__(self) -> None:
        self._way_ned_m: Floats = np.zeros(3)
        self._velocity_ned_m_s: Floats = np.zeros(3)
        self._stamp_ns: int | None = None

    def restart(self) -> None:
        """The next frame is the first."""
        self._stamp_ns = None

    def advance(self, stamp_ns: int, telemetry: Telemetry) -> Floats | None:
        """(3,), NED; None where the velocity is unknown or time is out of order: it begins anew."""
        velocity_ned_m_s: Floats = np.array(telemetry.velocity_ned_m_s)
        if self._stamp_ns is None:
            way_ned_m: Floats = np.zeros(3)
        else:
            passed_ns = stamp_ns - self._stamp_ns
            if not 0 < passed_ns <= LONGEST_GAP_NS:
                self.restart()
                return None
            mean_m_s = (self._velocity_ned_m_s + velocity_ned_m_s) / 2.0
            way_ned_m = self._way_ned_m + mean_m_s * passed_ns * 1e-9
        if not (np.isfinite(way_ned_m).all() and np.isfinite(velocity_ned_m_s).all()):
            self.restart()
            return None
        self._way_ned_m, self._velocity_ned_m_s = way_ned_m, velocity_ned_m_s
        self._stamp_ns = stamp_ns
        return way_ned_m
