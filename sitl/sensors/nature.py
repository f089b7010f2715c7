"""What there is to be sensed: air pressure, the Earth's field, the picture that moves below."""

import math
from typing import Final, NamedTuple

from companion.kernel.frames import Vector3, matrix_from_euler
from sitl.airframe import AirframeState

SEA_LEVEL_PA: Final = 101_325.0
_SEA_LEVEL_K: Final = 288.15
_LAPSE_K_PER_M: Final = 0.0065
_BAROMETRIC_EXPONENT: Final = 5.25588  # g M / (R L)
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


def slant(euler_rad: Vector3) -> float:
    """How much longer the way to the floor is along the vehicle's down axis; inf if it is level."""
    upright = math.cos(euler_rad[0]) * math.cos(euler_rad[1])
    return 1.0 / upright if upright > 1e-3 else math.inf
