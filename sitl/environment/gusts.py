"""Turbulence near the ground: the Dryden model of MIL-F-8785C, low-altitude form.

Intensity and length scales depend on the height and on W20, the mean wind at 20 ft (6.1 m): 7.7
m/s is light turbulence, 15 m/s moderate, 23 m/s severe. Below 10 ft the model is not defined; the
values of 10 ft are used, so indoors all heights are alike. Rotational gusts are left out.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from companion.kernel.frames import Vector3

_FT_PER_M: Final = 1.0 / 0.3048
_LOWEST_FT: Final = 10.0
_HIGHEST_FT: Final = 1000.0
_ROUGHNESS_FT: Final = 0.15  # of the ground, Category C (landing)
_SLOWEST_M_S: Final = 0.1  # at which the frozen field passes; slower, it would stand still
_SQRT3: Final = math.sqrt(3.0)


class Intensity(NamedTuple):
    """Standard deviations and length scales, along and across the wind, and vertically."""

    level_m_s: float
    vertical_m_s: float
    level_m: float
    vertical_m: float


def intensity(w20_m_s: float, height_m: float) -> Intensity:
    height_ft = max(_LOWEST_FT, min(_HIGHEST_FT, height_m * _FT_PER_M))
    shape = 0.177 + 0.000823 * height_ft
    vertical_m_s = 0.1 * w20_m_s
    return Intensity(
        vertical_m_s / shape**0.4,
        vertical_m_s,
        height_ft / shape**1.2 / _FT_PER_M,
        height_ft / _FT_PER_M,
    )


def mean_wind_m_s(w20_m_s: float, height_m: float) -> float:
    """The logarithmic profile that W20 belongs to."""
    height_ft = max(_LOWEST_FT, height_m * _FT_PER_M)
    return w20_m_s * math.log(height_ft / _ROUGHNESS_FT) / math.log(20.0 / _ROUGHNESS_FT)


class _Along:
    """White noise through 1 / (1 + T s), of unit variance; exact for any step."""

    def __init__(self) -> None:
        self.value = 0.0

    def step(self, steps_in_memory: float, draw: float) -> float:
        """``steps_in_memory`` is the step over the time constant T."""
        keep = math.exp(-steps_in_memory)
        self.value = keep * self.value + math.sqrt(1.0 - keep * keep) * draw
        return self.value


class _Across:
    """White noise through (1 + sqrt(3) T s) / (1 + T s)^2, of unit variance; exact for any step.

    It is sqrt(3) times a first-order lag, less sqrt(3) - 1 times the same lag passed twice. One
    noise drives both, so that its effects on them over a step are correlated.
    """

    def __init__(self) -> None:
        self._first = self._second = 0.0

    def step(self, steps_in_memory: float, draw: float, other: float) -> float:
        r, keep = steps_in_memory, math.exp(-steps_in_memory)
        square = keep * keep
        kick = math.sqrt(1.0 - square)
        shared = (0.5 - square * (r + 0.5)) / kick
        rest = 0.5 - square * (r * r + r + 0.5) - shared * shared
        self._second = keep * (self._second + r * self._first)
        self._second += shared * draw + math.sqrt(max(0.0, rest)) * other
        self._first = keep * self._first + kick * draw
        return (_SQRT3 * self._first + (1.0 - _SQRT3) * self._second) / math.sqrt(2.0)


class DrydenGusts:
    """Gusts at one place, in NED; to be stepped at a steady rate. They begin with a calm."""

    def __init__(self, rng: np.random.Generator, step_s: float) -> None:
        self._rng = rng
        self._step_s = step_s
        self._along = _Along()
        self._across, self._down = _Across(), _Across()

    def step(
        self, w20_m_s: float, height_m: float, wind_ned_m_s: Vector3, velocity_ned_m_s: Vector3
    ) -> Vector3:
        """The field is frozen and passes with the steady wind, at least at the speed of W20."""
        how = intensity(w20_m_s, height_m)
        passing_m_s = max(
            _SLOWEST_M_S,
            mean_wind_m_s(w20_m_s, height_m),
            math.dist(wind_ned_m_s, velocity_ned_m_s),
        )
        level = self._step_s * passing_m_s / how.level_m
        vertical = self._step_s * passing_m_s / how.vertical_m
        a, b, c, d, e = self._rng.standard_normal(5).tolist()
        along_m_s = how.level_m_s * self._along.step(level, a)
        across_m_s = how.level_m_s * self._across.step(level, b, c)
        down_m_s = how.vertical_m_s * self._down.step(vertical, d, e)
        bearing_rad = math.atan2(wind_ned_m_s[1], wind_ned_m_s[0])
        cos, sin = math.cos(bearing_rad), math.sin(bearing_rad)
        return cos * along_m_s - sin * across_m_s, sin * along_m_s + cos * across_m_s, down_m_s
