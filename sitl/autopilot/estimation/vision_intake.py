"""Samples of external vision on their way in: whose clock, which frame, too late, out of order."""

import math
from collections import deque
from typing import Final

from companion.kernel.frames import (
    Vector3,
    euler_from_quaternion,
    matrix_from_euler,
    ned_from_hfrd,
    wrap_angle_rad,
)
from companion.kernel.messages import NAN
from sitl.autopilot.estimation.vision_sample import Measured, VisionSample
from sitl.autopilot.interface import NAN3, Estimate
from sitl.autopilot.parameters import Number

MEMORY_S: Final = 0.5  # samples older than this come too late
_WAITING: Final = 64  # that came since the last update; of a client that floods the rest is lost
_OWN_CLOCK_S: Final = 5.0  # stamps farther from now than this are of another clock
_FARTHEST_M: Final = 10_000.0
_FASTEST_M_S: Final = 100.0


class VisionIntake:
    """``take`` samples at any time; ``drain`` those that may be used, at an update."""

    def __init__(self, parameters: dict[str, Number]) -> None:
        self._parameters = parameters
        self._waiting: deque[tuple[float, VisionSample]] = deque(maxlen=_WAITING)
        self.forget()

    def forget(self) -> None:
        """As if no sample had come yet."""
        self._waiting.clear()
        self._stamp_s = -math.inf
        self._turn_rad = NAN

    def take(self, sample: VisionSample, now_s: float) -> None:
        """``now_s`` is when it came."""
        self._waiting.append((now_s, sample))

    def drain(self, now: Estimate) -> list[Measured]:
        """What came since the last call and may be used, oldest first."""
        usable = []
        while self._waiting:
            came_s, sample = self._waiting.popleft()
            time_s = self._time_s(sample, came_s)
            if time_s > now.time_s - MEMORY_S and self._is_sound(sample):
                usable.append(self._measured(time_s, sample, now))
        return usable

    def _time_s(self, sample: VisionSample, came_s: float) -> float:
        """On the vehicle's clock; minus infinity for what comes out of order or twice."""
        stamp_s = sample.stamp_s
        if stamp_s == stamp_s:  # not NaN
            if 0.0 <= self._stamp_s - stamp_s < _OWN_CLOCK_S:
                return -math.inf
            self._stamp_s = stamp_s
        delay_s = self._parameters["EKF2_EV_DELAY"] * 1e-3
        own_clock = abs(came_s - stamp_s) < _OWN_CLOCK_S  # not if NaN
        return (min(stamp_s, came_s) if own_clock else came_s) - delay_s

    def _is_sound(self, sample: VisionSample) -> bool:
        quality = sample.quality_percent
        return quality >= 0 and (quality == 0 or quality >= self._parameters["EKF2_EV_QMIN"])

    def _measured(self, time_s: float, sample: VisionSample, now: Estimate) -> Measured:
        """Into NED: a frame whose north is unknown is taken as turned as it first appears."""
        euler = None if sample.attitude is None else euler_from_quaternion(sample.attitude)
        turn_rad = 0.0
        if not sample.north_known:
            if self._turn_rad != self._turn_rad and euler is not None:
                self._turn_rad = wrap_angle_rad(now.yaw_rad - euler[2])
            turn_rad = self._turn_rad
        yaw_rad = NAN if euler is None else wrap_angle_rad(euler[2] + turn_rad)
        velocity = _usable(sample.velocity_m_s, _FASTEST_M_S)
        if sample.velocity_in_body and velocity is not NAN3:
            roll, pitch, _ = euler or (now.roll_rad, now.pitch_rad, now.yaw_rad)
            heading = now.yaw_rad if euler is None else yaw_rad
            north, east, down = matrix_from_euler(roll, pitch, heading) @ velocity
            velocity = float(north), float(east), float(down)
        else:
            velocity = _turned(velocity, turn_rad)
        position = _turned(_usable(sample.position_m, _FARTHEST_M), turn_rad)
        return Measured(time_s, position, velocity, yaw_rad, sample)


def _turned(vector: Vector3, turn_rad: float) -> Vector3:
    if turn_rad == 0.0:
        return vector
    return (*ned_from_hfrd(vector[0], vector[1], turn_rad), vector[2])


def _usable(vector: Vector3, limit: float) -> Vector3:
    """NaN unless all axes are numbers, and within the limit."""
    return vector if all(abs(value) <= limit for value in vector) else NAN3
