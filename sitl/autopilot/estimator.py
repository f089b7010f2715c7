"""The state estimate: truth, plus errors that an indoor vehicle without satellites would have."""

import math
from typing import Final

import numpy as np

from companion.kernel.frames import wrap_angle_rad
from sitl.airframe import AirframeState
from sitl.autopilot.interface import Estimate
from sitl.settings import EstimatorSettings

_DRAWS_PER_UPDATE: Final = 15
_BLOCK_UPDATES: Final = 256


class _Wander:
    """First-order Gauss-Markov error: standard deviation kept, correlation time given."""

    def __init__(self, deviation: float, time_s: float, step_s: float) -> None:
        self._keep = math.exp(-step_s / time_s)
        self._kick = deviation * math.sqrt(1.0 - self._keep * self._keep)
        self.value = 0.0

    def step(self, draw: float) -> float:
        self.value = self._keep * self.value + self._kick * draw
        return self.value


class Estimator:
    """Errors start at zero, so that home is where the vehicle stands, and wander from there."""

    def __init__(
        self,
        settings: EstimatorSettings,
        update_hz: int,
        rng: np.random.Generator,
        start: AirframeState,
    ) -> None:
        self._settings = settings
        self._rng = rng
        self._step_s = step_s = 1.0 / update_hz
        self._draws: list[list[float]] = []
        bias = settings.velocity_bias_m_s, settings.velocity_bias_time_s
        attitude = math.radians(settings.attitude_error_deg), settings.attitude_error_time_s
        yaw = math.radians(settings.yaw_error_deg), settings.yaw_error_time_s
        self._bias_north = _Wander(*bias, step_s)
        self._bias_east = _Wander(*bias, step_s)
        self._height = _Wander(settings.height_error_m, settings.height_error_time_s, step_s)
        self._roll = _Wander(*attitude, step_s)
        self._pitch = _Wander(*attitude, step_s)
        self._yaw = _Wander(*yaw, step_s)
        self._drift_north_m = 0.0
        self._drift_east_m = 0.0
        self._start_s = 0.0
        self.estimate = self._estimated(start)

    def restart(self, time_s: float) -> None:
        """Begins to settle again; local positions still count from the first start."""
        self._start_s = time_s

    def ready(self, time_s: float) -> bool:
        """Whether the estimate may be flown on: it needs some seconds at rest after boot."""
        return time_s - self._start_s >= self._settings.ready_after_s

    def update(self, truth: AirframeState) -> Estimate:
        """The estimate of one moment; to be called at the rate given at the start."""
        self.estimate = self._estimated(truth)
        return self.estimate

    def _estimated(self, truth: AirframeState) -> Estimate:
        draw = self._next_draws()
        bias_north = self._bias_north.step(draw[0])
        bias_east = self._bias_east.step(draw[1])
        self._drift_north_m += bias_north * self._step_s
        self._drift_east_m += bias_east * self._step_s
        north, east, down = truth.position_ned_m
        v_north, v_east, v_down = truth.velocity_ned_m_s
        roll, pitch, yaw = truth.euler_rad
        p, q, r = truth.rates_frd_rad_s
        a_x, a_y, a_z = truth.specific_force_frd_m_s2
        v_noise = self._settings.velocity_noise_m_s
        gyro = self._settings.gyro_noise_rad_s
        force = self._settings.accelerometer_noise_m_s2
        return Estimate(
            truth.time_s,
            (
                north + self._drift_north_m,
                east + self._drift_east_m,
                down + self._height.step(draw[2]),
            ),
            (
                v_north + bias_north + v_noise * draw[6],
                v_east + bias_east + v_noise * draw[7],
                v_down + v_noise * draw[8],
            ),
            roll + self._roll.step(draw[3]),
            pitch + self._pitch.step(draw[4]),
            wrap_angle_rad(yaw + self._yaw.step(draw[5])),
            (p + gyro * draw[9], q + gyro * draw[10], r + gyro * draw[11]),
            (a_x + force * draw[12], a_y + force * draw[13], a_z + force * draw[14]),
        )

    def _next_draws(self) -> list[float]:
        """Standard normal numbers; drawn in blocks, because a call costs more than a number."""
        if not self._draws:
            block = self._rng.standard_normal((_BLOCK_UPDATES, _DRAWS_PER_UPDATE))
            self._draws = block[::-1].tolist()
        return self._draws.pop()
