"""Dead reckoning: truth, plus the errors of an indoor vehicle without satellites."""

import math
from typing import Final, NamedTuple

import numpy as np

from companion.kernel.frames import Vector3, wrap_angle_rad
from sitl.airframe import GRAVITY_M_S2, AirframeState
from sitl.autopilot.interface import Estimate
from sitl.settings import EstimatorSettings

_DRAWS_PER_UPDATE: Final = 15
_BLOCK_UPDATES: Final = 256
BAROMETER_ERROR_M: Final = 0.15  # of a consumer part indoors: doors, draught, its own heat
_BAROMETER_TIME_S: Final = 20.0
_ACCELEROMETER_BIAS_M_S2: Final = 0.03  # what calibration leaves of a consumer part
_GYRO_BIAS_RAD_S: Final = math.radians(0.1)
_STILL: Final[Vector3] = (0.0, 0.0, 0.0)


class Senses(NamedTuple):
    """What dead reckoning can stand on now."""

    flow: bool = True
    range_finder: bool = True
    barometer: bool = True
    magnetometer: bool = True


ALL_SENSES: Final = Senses()


class _Wander:
    """First-order Gauss-Markov error: standard deviation kept, correlation time given."""

    def __init__(self, deviation: float, time_s: float, step_s: float) -> None:
        self._keep = math.exp(-step_s / time_s)
        self._kick = deviation * math.sqrt(1.0 - self._keep * self._keep)
        self.value = 0.0

    def step(self, draw: float) -> float:
        self.value = self._keep * self.value + self._kick * draw
        return self.value


class DeadReckoning:
    """Errors start at zero, so that home is where the vehicle stands, and wander from there.

    With all senses velocity is measured by optical flow, height by the range finder, heading by
    the magnetometer. Without flow velocity is what tilted gravity adds up to; without the range
    finder height is the barometer's, and without that also a sum; without the magnetometer the
    gyroscope's bias turns the heading away.
    """

    def __init__(
        self, settings: EstimatorSettings, update_hz: int, rng: np.random.Generator
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
        # What comes on top when senses fail; drawn only then, from numbers of its own.
        self._spare = rng.spawn(1)[0]
        self._barometer = _Wander(BAROMETER_ERROR_M, _BAROMETER_TIME_S, step_s)
        self._sum_ned_m_s: Vector3 = _STILL
        self._height_sum_m = 0.0
        self._turned_rad = 0.0
        self.set_drift(settings.drift_ned_m_s)

    def set_drift(self, drift_ned_m_s: Vector3) -> None:
        """A fault: velocity is measured wrong by this, and the position walks away with it."""
        self._fault_ned_m_s = drift_ned_m_s
        self._slip_anew()

    def update(self, truth: AirframeState, senses: Senses) -> Estimate:
        """The estimate of one moment; to be called at the rate given at the start."""
        draw = self._next_draws()
        if senses is not ALL_SENSES:
            self._miss(senses, truth.euler_rad[2])
        slip_north, slip_east, slip_down = self._slip_ned_m_s
        bias_north = self._bias_north.step(draw[0])
        bias_east = self._bias_east.step(draw[1])
        self._drift_north_m += (bias_north + slip_north) * self._step_s
        self._drift_east_m += (bias_east + slip_east) * self._step_s
        self._height_sum_m += slip_down * self._step_s
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
                down + self._height.step(draw[2]) + self._barometer.value + self._height_sum_m,
            ),
            (
                v_north + bias_north + v_noise * draw[6] + slip_north,
                v_east + bias_east + v_noise * draw[7] + slip_east,
                v_down + v_noise * draw[8] + slip_down,
            ),
            roll + self._roll.step(draw[3]),
            pitch + self._pitch.step(draw[4]),
            wrap_angle_rad(yaw + self._yaw.step(draw[5]) + self._turned_rad),
            (p + gyro * draw[9], q + gyro * draw[10], r + gyro * draw[11]),
            (a_x + force * draw[12], a_y + force * draw[13], a_z + force * draw[14]),
        )

    def regain(self, before: Senses, senses: Senses) -> tuple[float, float]:
        """Senses that are back put right what was wrong; the level velocity's error till then."""
        north, east, down = self._sum_ned_m_s
        back = senses.flow and not before.flow
        jump = (north, east) if back else (0.0, 0.0)
        if senses.range_finder and not before.range_finder:
            self._barometer.value = self._height_sum_m = 0.0
        if senses.range_finder or senses.barometer:
            down = 0.0
        if senses.magnetometer:
            self._turned_rad = 0.0
        self._sum_ned_m_s = north - jump[0], east - jump[1], down
        self._slip_anew()
        return jump

    def _miss(self, senses: Senses, yaw_rad: float) -> None:
        """One step of the errors that grow without a sense."""
        v_north, v_east, v_down = self._sum_ned_m_s
        if not senses.flow:
            # Gravity seen under a wrong tilt is taken for an acceleration.
            forward = GRAVITY_M_S2 * self._pitch.value + _ACCELEROMETER_BIAS_M_S2
            right = -GRAVITY_M_S2 * self._roll.value
            cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
            v_north += (cos_yaw * forward - sin_yaw * right) * self._step_s
            v_east += (sin_yaw * forward + cos_yaw * right) * self._step_s
        if not senses.range_finder:
            if senses.barometer:
                self._barometer.step(float(self._spare.standard_normal()))
            else:
                v_down += _ACCELEROMETER_BIAS_M_S2 * self._step_s
        if not senses.magnetometer:
            self._turned_rad += _GYRO_BIAS_RAD_S * self._step_s
        self._sum_ned_m_s = v_north, v_east, v_down
        self._slip_anew()

    def _slip_anew(self) -> None:
        """Velocity that is measured, or summed up, wrong beyond the usual."""
        north, east, down = self._sum_ned_m_s
        f_north, f_east, f_down = self._fault_ned_m_s
        self._slip_ned_m_s = north + f_north, east + f_east, down + f_down

    def _next_draws(self) -> list[float]:
        """Standard normal numbers; drawn in blocks, because a call costs more than a number."""
        if not self._draws:
            block = self._rng.standard_normal((_BLOCK_UPDATES, _DRAWS_PER_UPDATE))
            self._draws = block[::-1].tolist()
        return self._draws.pop()
