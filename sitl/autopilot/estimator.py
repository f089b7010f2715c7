"""The state estimate, and what may be said of it: which senses it stands on, how good it is."""

import math
from typing import Final

import numpy as np

from sitl.airframe import GRAVITY_M_S2, AirframeState
from sitl.autopilot.estimation.dead_reckoning import (
    ALL_SENSES,
    BAROMETER_ERROR_M,
    DeadReckoning,
    Senses,
)
from sitl.autopilot.estimation.external_vision import ExternalVision
from sitl.autopilot.estimation.quality import Quality
from sitl.autopilot.estimation.vision_sample import VisionSample
from sitl.autopilot.interface import Estimate
from sitl.autopilot.parameters import Number
from sitl.failures import Failures, Unit
from sitl.sensors.receiver import Fix
from sitl.settings import EstimatorSettings

_RECENT_S: Final = 0.5  # after its last use a source still counts as one


class Estimator:
    """Dead reckoning, mended by external vision where a client sends it."""

    def __init__(
        self,
        settings: EstimatorSettings,
        update_hz: int,
        rng: np.random.Generator,
        parameters: dict[str, Number],
        failures: Failures,
        start: AirframeState,
    ) -> None:
        self._settings = settings
        self._parameters = parameters
        self._failures = failures
        self._step_s = 1.0 / update_hz
        self.reckoning = DeadReckoning(settings, update_hz, rng)
        self.vision = ExternalVision(parameters)
        self._senses = ALL_SENSES
        self._start_s = 0.0
        self._level_aided_s = self._height_aided_s = start.time_s
        self.level_valid = self.height_valid = True
        """Whether anything but accelerations told of this motion within EKF2_NOAID_TOUT."""
        self.estimate = self.update(start)

    def restart(self, time_s: float) -> None:
        """Begins to settle again; local positions still count from the first start."""
        self._start_s = self._level_aided_s = self._height_aided_s = time_s
        self.vision.forget()

    def ready(self, time_s: float) -> bool:
        """Whether the estimate may be flown on: it needs some seconds at rest after boot."""
        settled = time_s - self._start_s >= self._settings.ready_after_s
        return settled and self.level_valid and self.height_valid

    def take_vision(self, sample: VisionSample, now_s: float) -> None:
        """A client's measurement, as it comes."""
        if self._failures.works(Unit.VISION):
            self.vision.take(sample, now_s)

    def take_fix(self, fix: Fix) -> None:
        """Of the satellites; comes with the update that follows."""
        if self._failures.works(Unit.GPS):
            self.vision.take_fix(fix)

    def update(self, truth: AirframeState) -> Estimate:
        """The estimate of one moment; to be called at the rate given at the start."""
        senses = self._sense()
        estimate, vision = self.reckoning.update(truth, senses), self.vision
        if vision.begun:
            estimate = vision.update(estimate, self._step_s, senses.flow)
        if senses is ALL_SENSES:
            self._level_aided_s = self._height_aided_s = estimate.time_s
            self.level_valid = self.height_valid = True
        else:
            self._judge(senses, estimate.time_s)
        self.estimate = estimate
        return estimate

    def _judge(self, senses: Senses, time_s: float) -> None:
        """What is still known while some senses fail."""
        level_s, height_s = self.vision.level_used_s, self.vision.down_used_s
        if senses.flow:
            level_s = time_s
        if senses.range_finder or senses.barometer:
            height_s = time_s
        self._level_aided_s = max(self._level_aided_s, level_s)
        self._height_aided_s = max(self._height_aided_s, height_s)
        patience_s = self._parameters["EKF2_NOAID_TOUT"] * 1e-6
        self.level_valid = time_s - self._level_aided_s <= patience_s
        self.height_valid = time_s - self._height_aided_s <= patience_s

    def quality(self) -> Quality:
        vision, settings, time_s = self.vision, self._settings, self.estimate.time_s
        level_m, level_m_s = self._walked(time_s)
        yaw_rad = math.radians(settings.yaw_error_deg)
        height_m = settings.height_error_m if self._senses.range_finder else BAROMETER_ERROR_M
        if vision.level_used_s > -math.inf:
            level_m, level_m_s = vision.level_deviations
        if vision.yaw_used_s > -math.inf:
            yaw_rad = math.sqrt(vision.yaw.variance)
        return Quality(
            level_valid=self.level_valid,
            height_valid=self.height_valid,
            absolute=time_s - vision.level_used_s <= _RECENT_S,
            level_deviation_m=level_m,
            height_deviation_m=math.hypot(height_m, math.sqrt(vision.down.variance)),
            velocity_deviation_m_s=math.hypot(level_m_s, settings.velocity_noise_m_s),
            tilt_deviation_rad=math.radians(settings.attitude_error_deg),
            yaw_deviation_rad=yaw_rad,
            ratios=vision.ratios,
            resets=vision.resets,
        )

    def _sense(self) -> Senses:
        """What works and is wanted now; asked at every step, so all at once is the quick answer."""
        parameters, failures = self._parameters, self._failures
        flow = parameters["EKF2_OF_CTRL"] == 1
        range_finder = parameters["EKF2_RNG_CTRL"] != 0
        barometer = parameters["EKF2_BARO_CTRL"] == 1
        magnetometer = parameters["SYS_HAS_MAG"] != 0
        if flow and range_finder and barometer and magnetometer and failures.none:
            senses = ALL_SENSES
        else:
            senses = Senses(
                flow and failures.works(Unit.OPTICAL_FLOW),
                range_finder and failures.works(Unit.RANGE_FINDER),
                barometer and failures.works(Unit.BAROMETER),
                magnetometer and failures.works(Unit.MAGNETOMETER),
            )
        if senses is not self._senses:
            self.vision.shift_velocity(*self.reckoning.regain(self._senses, senses))
            self._senses = senses
        return senses

    def _walked(self, time_s: float) -> tuple[float, float]:
        """(position, velocity): standard deviations on the level of dead reckoning since start."""
        deviation, memory_s = self._settings.velocity_bias_m_s, self._settings.velocity_bias_time_s
        kept_s = memory_s * (1.0 - math.exp(-time_s / memory_s))
        walked_m = deviation * math.sqrt(2.0 * memory_s * (time_s - kept_s))
        alone_s = time_s - self._level_aided_s
        tilted_m_s2 = GRAVITY_M_S2 * math.radians(self._settings.attitude_error_deg)
        return (
            math.hypot(walked_m, 0.5 * tilted_m_s2 * alone_s * alone_s),
            math.hypot(deviation, tilted_m_s2 * alone_s),
        )
