"""Places on Earth and in the vehicle's local frame."""

import logging
import math
from typing import Annotated, Final, NamedTuple

from msgspec import Meta, ValidationError, convert
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import Vector3
from companion.kernel.settings import Settings
from sitl.autopilot.home import Home

logger = logging.getLogger(__name__)

METRES_PER_DEGREE: Final = 111_319.5
"""Along a meridian, or along the equator; a room is too small for the difference to matter."""

ABOVE_SEA: Final = frozenset({mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT})
ABOVE_HOME: Final = frozenset(
    {mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT}
)


class Origin(Settings, frozen=True):
    """Where on Earth local (0, 0, 0) is said to be: the floor under the vehicle at the start.

    Home is there too, until it is moved. The default is a flight hall in Delft.
    """

    latitude_deg: Annotated[float, Meta(ge=-85.0, le=85.0)] = 51.9906
    longitude_deg: Annotated[float, Meta(ge=-180.0, le=180.0)] = 4.3768
    amsl_m: Annotated[float, Meta(ge=-500.0, le=10_000.0)] = 10.0
    """Height above mean sea level."""

    def degrees(self, position_ned_m: Vector3) -> tuple[float, float]:
        """(latitude, longitude)."""
        north_m, east_m, _ = position_ned_m
        return (
            self.latitude_deg + north_m / METRES_PER_DEGREE,
            self.longitude_deg + east_m / self._metres_per_degree_east,
        )

    def level_m(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """(north, east); NaN stays NaN."""
        return (
            (latitude_deg - self.latitude_deg) * METRES_PER_DEGREE,
            (longitude_deg - self.longitude_deg) * self._metres_per_degree_east,
        )

    @property
    def _metres_per_degree_east(self) -> float:
        return METRES_PER_DEGREE * math.cos(math.radians(self.latitude_deg))


class Datum(NamedTuple):
    """What the numbers of a place count from."""

    origin: Origin
    home_down_m: float = 0.0
    """Of home, in the local frame: relative heights count from it."""

    def down_m(self, frame: int, height: float) -> float:
        """From z of a message in this MAV_FRAME; every other frame than these is local."""
        if frame in ABOVE_SEA:
            return self.origin.amsl_m - height
        return self.home_down_m - height if frame in ABOVE_HOME else height


class Earth:
    """Where the vehicle's world lies, until a client says otherwise (SET_GPS_GLOBAL_ORIGIN)."""

    def __init__(self, origin: Origin, home: Home) -> None:
        self.origin = origin
        self._home = home

    @property
    def datum(self) -> Datum:
        return Datum(self.origin, self._home.position_ned_m[2])

    def move(self, message: mavlink.MAVLink_message) -> None:
        """No change for a place that is none."""
        try:
            self.origin = convert(
                {
                    "latitude_deg": message.latitude * 1e-7,
                    "longitude_deg": message.longitude * 1e-7,
                    "amsl_m": message.altitude * 1e-3,
                },
                Origin,
            )
        except ValidationError as error:
            logger.warning("SET_GPS_GLOBAL_ORIGIN: %s", error)
