"""The sensors behind the messages: read when somebody asks, so that they cost nothing else.

All readings of one moment are made from the same truth; each is drawn once, however often it is
asked for. The random numbers are none of the estimator's: who listens does not change the flight.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple, TypeVar, cast

import numpy as np

from companion.kernel.frames import Vector3
from sitl.airframe import AirframeState
from sitl.autopilot.parameters import Number
from sitl.failures import Failures, Kind, Unit
from sitl.sensors.nature import (
    Air,
    air_at,
    down_axis_ned,
    field_frd_gauss,
    floor_along_m,
    flow_rad_s,
)
from sitl.sensors.receiver import Fix, Receiver

FLOW_PERIOD_S: Final = 0.02
"""Time that one reading of the optical flow adds up."""
# Noise of consumer parts: 0.1 m of height, 2 milligauss, 1 cm of sonar, 1 % of a radian per second.
_PRESSURE_NOISE_PA: Final = 1.2
_FIELD_NOISE_GAUSS: Final = 0.002
_RANGE_NOISE_M: Final = 0.01
_FLOW_NOISE_RAD_S: Final = 0.01
_FOCUS_M: Final = 0.08  # nearer than this to the ground, the flow camera sees it no faster
_GOOD_PERCENT: Final = 100
_NOWHERE: Final[Vector3] = (0.0, 0.0, 0.0)

Reading = TypeVar("Reading")


class Flow(NamedTuple):
    """Added up over FLOW_PERIOD_S, about forward and right; see ``nature.flow_rad_s``."""

    turned_rad: tuple[float, float]
    gyro_rad: Vector3
    quality_percent: int
    distance_m: float
    """That the range finder saw; negative if it saw none."""


class Sensors:
    """``truth`` is to be kept up to date by whoever flies."""

    def __init__(
        self,
        truth: AirframeState,
        parameters: dict[str, Number],
        failures: Failures,
        receiver: Receiver,
        rng: np.random.Generator,
    ) -> None:
        self.truth = truth
        self.floor_amsl_m = 0.0
        """At the start: what the barometer feels besides the vehicle's height."""
        self.way_m: Callable[[Vector3, Vector3], float] = floor_along_m
        """From a place along a direction, both NED from the start, to the next surface."""
        self._parameters = parameters
        self._failures = failures
        self._receiver = receiver
        self._rng = rng
        self._last: dict[Unit, tuple[float, object]] = {}

    def works(self, unit: Unit) -> bool:
        return self._failures.works(unit)

    def air(self) -> Air | None:
        air = self._read(Unit.BAROMETER, self._air, self._any_air)
        if air is None:
            return None
        off_pa = self._parameters["SIM_BARO_OFF_P"] * 100.0
        return Air(air.pressure_pa + off_pa, air.temperature_k + self._parameters["SIM_BARO_OFF_T"])

    def field_frd_gauss(self) -> Vector3 | None:
        if not self._parameters["SYS_HAS_MAG"]:
            return None
        return self._read(Unit.MAGNETOMETER, self._field, lambda: self._noisy(_NOWHERE, 1.0))

    def range_m(self) -> float | None:
        """Of the downward range finder; its limits where it sees nothing between them."""
        given_m = self._parameters["SIH_DISTSNSR_OVR"]
        least_m, most_m = self.range_limits_m
        seen_m = self._read(
            Unit.RANGE_FINDER, self._range_m, lambda: self._rng.uniform(least_m, most_m)
        )
        if seen_m is None or given_m >= 0.0:
            return None if seen_m is None else given_m
        return min(most_m, max(least_m, seen_m))

    @property
    def range_limits_m(self) -> tuple[float, float]:
        least_m = self._parameters["SIH_DISTSNSR_MIN"]
        return least_m, max(least_m, self._parameters["SIH_DISTSNSR_MAX"])

    def flow(self) -> Flow | None:
        return self._read(Unit.OPTICAL_FLOW, self._flow, self._any_flow)

    def fix(self) -> Fix | None:
        """None without a receiver, or with too few satellites."""
        if self._receiver.fix is None:
            return None
        return self._read(Unit.GPS, lambda: self._receiver.fix, self._any_fix)

    def _read(
        self, unit: Unit, measure: Callable[[], Reading], invent: Callable[[], Reading]
    ) -> Reading | None:
        """Once for each moment; the same again if stuck, something invented if garbage."""
        kind = self._failures.of(unit)
        if kind is Kind.OFF:
            return None
        read_s, last = self._last.get(unit, (math.nan, None))
        if last is not None and (kind is Kind.STUCK or read_s == self.truth.time_s):
            return cast(Reading, last)
        reading = invent() if kind is Kind.GARBAGE else measure()
        self._last[unit] = self.truth.time_s, reading
        return reading

    # -- sound ---------------------------------------------------------------------------------

    def _air(self) -> Air:
        pressure_pa, temperature_k = air_at(self.floor_amsl_m - self.truth.position_ned_m[2])
        return Air(pressure_pa + _PRESSURE_NOISE_PA * self._rng.standard_normal(), temperature_k)

    def _field(self) -> Vector3:
        return self._noisy(field_frd_gauss(self.truth), _FIELD_NOISE_GAUSS)

    def _way_down_m(self) -> float:
        """From the feet, where the sensors are, along the vehicle's down axis."""
        return self.way_m(self.truth.position_ned_m, down_axis_ned(self.truth.euler_rad))

    def _range_m(self) -> float:
        return self._way_down_m() + _RANGE_NOISE_M * self._rng.standard_normal()

    def _flow(self) -> Flow:
        range_m = self.range_m()
        distance_m = max(_FOCUS_M, self._way_down_m())
        about_forward, about_right = flow_rad_s(self.truth, distance_m)
        noise = _FLOW_NOISE_RAD_S * self._rng.standard_normal(2)
        p, q, r = self.truth.rates_frd_rad_s
        return Flow(
            (
                (about_forward + float(noise[0])) * FLOW_PERIOD_S,
                (about_right + float(noise[1])) * FLOW_PERIOD_S,
            ),
            (p * FLOW_PERIOD_S, q * FLOW_PERIOD_S, r * FLOW_PERIOD_S),
            _GOOD_PERCENT,
            -1.0 if range_m is None else range_m,
        )

    # -- garbage -------------------------------------------------------------------------------

    def _any_air(self) -> Air:
        return Air(self._rng.uniform(30_000.0, 120_000.0), self._rng.uniform(233.0, 358.0))

    def _any_flow(self) -> Flow:
        turned = self._noisy(_NOWHERE, 1.0)
        return Flow(turned[:2], self._noisy(_NOWHERE, 1.0), 0, -1.0)

    def _any_fix(self) -> Fix:
        return Fix(
            self.truth.time_s,
            self._noisy(_NOWHERE, 1000.0),
            self._noisy(_NOWHERE, 10.0),
            int(self._parameters["SIM_GPS_USED"]),
        )

    def _noisy(self, vector: Vector3, deviation: float) -> Vector3:
        x, y, z = deviation * self._rng.standard_normal(3)
        return vector[0] + float(x), vector[1] + float(y), vector[2] + float(z)
