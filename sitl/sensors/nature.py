"""What there is to be sensed: air pressure, the Earth's field, the picture that moves below."""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from companion.kernel.frames import Vector3, matrix_from_euler
from sitl.airframe import AirframeState

SEA_LEVEL_PA: Final = 101_325.0
_SEA_LEVEL_K: Final = 288.15
_LAPSE_K_PER_M: Final = 0.0065
_BAROMETRIC_EXPONENT: Final = 5.25588  # g M / (R L)
_LEVEL: Final = 1e-3  # sine of the flattest way that is followed to the floor
_STRIDES: Final = 64
_TOUCHED_M: Final = 0.003
FIELD_NED_GAUSS: Final[Vector3] = (0.1929, 0.0077, 0.4520)
"""At Delft, 2.3 degrees east of true north and 67 degrees down (World Magnetic Model 2025)."""


class Air(NamedTuple):
    pressure_pa: float
    temperature_k: float


def air_at(amsl_m: float) -> Air:
    """The standard atmosphere (ISO 2533) so far above the sea."""
    temperature_k = _SEA_LEVEL_K - _LAPSE_K_PER_M * amsl_m
    ratio = temperature_k / _SEA_LEVEL_K
    return Air(SEA_LEVEL_PA * ratio**_BAROMETRIC_EXPONENT, temperature_k)


def height_amsl_m(pressure_pa: float) -> float:
    """Where the standard atmosphere has this pressure."""
    ratio = math.pow(pressure_pa / SEA_LEVEL_PA, 1.0 / _BAROMETRIC_EXPONENT)
    return _SEA_LEVEL_K / _LAPSE_K_PER_M * (1.0 - ratio)


def field_frd_gauss(truth: AirframeState) -> Vector3:
    """The Earth's magnetic field along the vehicle's axes."""
    forward, right, down = matrix_from_euler(*truth.euler_rad).T @ FIELD_NED_GAUSS
    return float(forward), float(right), float(down)


def flow_rad_s(truth: AirframeState, distance_m: float) -> tuple[float, float]:
    """How fast the ground turns under a camera that looks down, about forward and about right.

    Signs are OPTICAL_FLOW_RAD's: turning right about an axis makes a positive flow about it, flying
    right a negative one about forward, flying forward a positive one about right.
    """
    velocity = matrix_from_euler(*truth.euler_rad).T @ truth.velocity_ned_m_s
    roll_rate, pitch_rate, _ = truth.rates_frd_rad_s
    return (
        roll_rate - float(velocity[1]) / distance_m,
        pitch_rate + float(velocity[0]) / distance_m,
    )


def down_axis_ned(euler_rad: Vector3) -> Vector3:
    """Where the vehicle's down axis points."""
    roll, pitch, yaw = euler_rad
    level = math.cos(roll) * math.sin(pitch)
    return (
        math.cos(yaw) * level + math.sin(yaw) * math.sin(roll),
        math.sin(yaw) * level - math.cos(yaw) * math.sin(roll),
        math.cos(roll) * math.cos(pitch),
    )


def floor_along_m(position_ned_m: Vector3, direction_ned: Vector3) -> float:
    """The way from there to the floor at the start (down is 0); inf if it leads elsewhere."""
    if direction_ned[2] < _LEVEL:
        return math.inf
    return max(0.0, -position_ned_m[2] / direction_ned[2])


def surface_along_m(
    nearest: Callable[[Vector3], tuple[float, Vector3]],
    position_ned_m: Vector3,
    direction_ned: Vector3,
    limit_m: float,
) -> float:
    """The way to the next surface, at most ``limit_m``: as far as is clear, again and again."""
    north, east, down = direction_ned
    way_m = 0.0
    for _ in range(_STRIDES):
        here = (
            position_ned_m[0] + way_m * north,
            position_ned_m[1] + way_m * east,
            position_ned_m[2] + way_m * down,
        )
        clear_m = nearest(here)[0]
        if clear_m < _TOUCHED_M:
            break
        way_m += clear_m
        if way_m >= limit_m:
            return limit_m
    return way_m
