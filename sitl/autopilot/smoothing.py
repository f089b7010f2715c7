"""References that change no faster than a limit on acceleration and jerk allows."""

import math
from typing import Final

_SETTLE_1_S: Final = 8.0  # near the target the rest shrinks exponentially with this rate


def _wanted_acceleration(missing: float, acceleration: float, jerk: float) -> float:
    """Greatest acceleration from which the jerk limit still stops in time at the target.

    missing: speed still to gain, >= 0. Constant jerk J from acceleration a to 0 gains a^2 / (2 J).
    """
    return min(_SETTLE_1_S * missing, math.sqrt(2.0 * jerk * missing), acceleration)


class SmoothVelocity2:
    """Horizontal reference: limits apply to the vector, so no direction is faster.

    ``expected_*`` is the reference as a vehicle shows it that follows with a lag of ``lag_s``: what
    a measurement is to be compared with, so that the lag is not taken for an error.
    """

    def __init__(self, step_s: float, lag_s: float) -> None:
        self._step_s = step_s
        self._catch_up = 1.0 - math.exp(-step_s / lag_s)
        self.reset(0.0, 0.0)

    def reset(self, north_m_s: float, east_m_s: float) -> None:
        self.north_m_s, self.east_m_s = north_m_s, east_m_s
        self.north_m_s2 = self.east_m_s2 = 0.0
        self.expected_north_m_s, self.expected_east_m_s = north_m_s, east_m_s

    def step(
        self, north_m_s: float, east_m_s: float, acceleration_m_s2: float, jerk_m_s3: float
    ) -> None:
        """Moves one step towards this velocity."""
        d_north, d_east = north_m_s - self.north_m_s, east_m_s - self.east_m_s
        missing = math.sqrt(d_north * d_north + d_east * d_east)
        if missing > 0.0:
            share = _wanted_acceleration(missing, acceleration_m_s2, jerk_m_s3) / missing
            d_north, d_east = d_north * share, d_east * share
        j_north, j_east = d_north - self.north_m_s2, d_east - self.east_m_s2
        change = math.sqrt(j_north * j_north + j_east * j_east)
        allowed = jerk_m_s3 * self._step_s
        if change > allowed:
            j_north, j_east = j_north * allowed / change, j_east * allowed / change
        self.north_m_s2 += j_north
        self.east_m_s2 += j_east
        self.north_m_s += self.north_m_s2 * self._step_s
        self.east_m_s += self.east_m_s2 * self._step_s
        self.expected_north_m_s += self._catch_up * (self.north_m_s - self.expected_north_m_s)
        self.expected_east_m_s += self._catch_up * (self.east_m_s - self.expected_east_m_s)


class SmoothSpeed:
    """The same along one axis, with a limit of its own for each direction."""

    def __init__(self, step_s: float) -> None:
        self._step_s = step_s
        self.reset(0.0)

    def reset(self, speed: float) -> None:
        self.speed = speed
        self.acceleration = 0.0

    def step(self, speed: float, rise_limit: float, fall_limit: float, jerk: float) -> None:
        """Moves one step towards ``speed``; ``rise_limit`` bounds positive acceleration."""
        missing = speed - self.speed
        if missing >= 0.0:
            wanted = _wanted_acceleration(missing, rise_limit, jerk)
        else:
            wanted = -_wanted_acceleration(-missing, fall_limit, jerk)
        allowed = jerk * self._step_s
        self.acceleration += max(-allowed, min(allowed, wanted - self.acceleration))
        self.speed += self.acceleration * self._step_s
