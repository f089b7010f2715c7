"""One moment of the vehicle, from which every message of that moment is built."""

import math
from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.estimation.quality import Quality
from sitl.autopilot.interface import Estimate, VehicleStatus
from sitl.mavlink.places import Origin
from sitl.sensors.suite import Sensors

Message: TypeAlias = mavlink.MAVLink_message


class Snapshot(NamedTuple):
    """What is known, and where on Earth it is said to be."""

    estimate: Estimate
    status: VehicleStatus
    time_s: float
    """When it is told: since boot, as are all stamps. The estimate may be a little older."""
    parameters: Mapping[str, float | int]
    origin: Origin
    sensors: Sensors
    """Read when they are asked."""
    quality: Quality

    @property
    def boot_ns(self) -> int:
        return round(self.time_s * 1e9)

    @property
    def boot_ms(self) -> int:
        return round(self.estimate.time_s * 1e3)

    @property
    def boot_us(self) -> int:
        return round(self.estimate.time_s * 1e6)

    @property
    def ready(self) -> bool:
        return self.status.ready_to_arm or self.status.armed

    @property
    def height_m(self) -> float:
        """Above the floor at the start."""
        return -self.estimate.position_ned_m[2]

    @property
    def amsl_m(self) -> float:
        return self.origin.amsl_m + self.height_m

    @property
    def height_over_home_m(self) -> float:
        return self.height_m + self.status.home_ned_m[2]


def percent(share_norm: float, unknown: int) -> int:
    return round(100.0 * share_norm) if math.isfinite(share_norm) else unknown
