"""External vision, or satellites: what is seen from outside mends dead reckoning.

As PX4's EKF2 does it: EKF2_EV_CTRL chooses what is used, EKF2_EV_DELAY says how old samples are,
EKF2_EVP_NOISE, EKF2_EVV_NOISE and EKF2_EVA_NOISE bound the noise that they claim from below,
EKF2_EVP_GATE and EKF2_EVV_GATE are the standard deviations beyond which they are not believed.
Unlike there, roll and pitch are not touched, and the four axes are filtered one by one.
"""

import math
from collections import deque
from typing import Final

from companion.kernel.frames import wrap_angle_rad
from sitl.autopilot.estimation.axis_filter import AxisFilter
from sitl.autopilot.estimation.quality import Ratios
from sitl.autopilot.estimation.vision_intake import MEMORY_S, VisionIntake
from sitl.autopilot.estimation.vision_sample import Measured, VisionSample
from sitl.autopilot.interface import Estimate
from sitl.autopilot.parameters import Number
from sitl.sensors.receiver import Fix

_QUIET_S: Final = 1.0  # without a usable sample for this long vision has stopped
_YAW_GATE: Final = 5.0  # standard deviations
_VISION_HEIGHT: Final = 3  # of EKF2_HGT_REF
# How fast the errors' rates may wander. Level: a sudden drift of 0.3 m/s is found within 3 s, and
# noise of 0.1 m at 30 Hz moves the velocity by 0.02 m/s.
_LEVEL_WALK: Final = 0.02
_DOWN_WALK: Final = 0.01
_YAW_WALK: Final = 0.002
_RATE_TIME_S: Final = 10.0
_VAGUEST: Final = 1e4  # the greatest variance that a client may claim
_HASTE: Final = 5.0  # without optical flow velocity is wrong by an integral of the tilt's error
_FIX_BIT = 1  # of EKF2_GPS_CTRL; that of velocity is 4 as well
_LEVEL_BIT, _DOWN_BIT, _VELOCITY_BIT, _YAW_BIT = 1, 2, 4, 8  # of EKF2_EV_CTRL


class _Use:
    """Whether one kind of measurement runs, and since when it is refused."""

    def __init__(self) -> None:
        self.used_s = self.seen_s = -math.inf

    def begins(self, now_s: float, patience_s: float) -> bool:
        """Whether to jump to what is seen: at first, after silence, or refused for too long."""
        silent = now_s - self.seen_s > _QUIET_S
        self.seen_s = now_s
        return silent or now_s - self.used_s > patience_s


class ExternalVision:
    """Costs nothing until the first sample comes."""

    def __init__(self, parameters: dict[str, Number]) -> None:
        self._parameters = parameters
        self._intake = VisionIntake(parameters)
        self._past: deque[Estimate] = deque()
        self.north = AxisFilter(_LEVEL_WALK, _RATE_TIME_S)
        self.east = AxisFilter(_LEVEL_WALK, _RATE_TIME_S)
        self.down = AxisFilter(_DOWN_WALK, _RATE_TIME_S)
        self.yaw = AxisFilter(_YAW_WALK, _RATE_TIME_S)
        self.resets = 0
        """How often the estimate has jumped to what was seen."""
        self.forget()

    def forget(self) -> None:
        """As if no sample had come yet."""
        self._intake.forget()
        self._past.clear()
        for axis in (self.north, self.east, self.down, self.yaw):
            axis.reset(0.0, 0.0)
        self.begun = False
        self.ratios = Ratios()
        self._level_use, self._height_use = _Use(), _Use()
        self._velocity_use, self._yaw_use = _Use(), _Use()
        self._flow = True
        self._fix: Fix | None = None
        self._fix_used_s = -math.inf
        self._height_bias_m = 0.0
        self._reset_counter = 0

    @property
    def level_used_s(self) -> float:
        """When position or velocity on the level was last mended."""
        return max(self._seen_s, self._fix_used_s)

    @property
    def _seen_s(self) -> float:
        """The same, by vision alone."""
        return max(self._level_use.used_s, self._velocity_use.used_s)

    @property
    def level_deviations(self) -> tuple[float, float]:
        """(position, velocity): standard deviations of the mended estimate on the level."""
        return math.sqrt(self.north.variance), math.sqrt(self.north.rate_variance)

    @property
    def down_used_s(self) -> float:
        return self._height_use.used_s

    @property
    def yaw_used_s(self) -> float:
        return self._yaw_use.used_s

    def take(self, sample: VisionSample, now_s: float) -> None:
        """``now_s`` is when it came; it is used at the next update."""
        if self._parameters["EKF2_EV_CTRL"]:
            self.begun = True
            self._intake.take(sample, now_s)

    def take_fix(self, fix: Fix) -> None:
        """Of satellites: EKF2_GPS_CTRL's level position and velocity; vision goes before it."""
        if self._parameters["EKF2_GPS_CTRL"]:
            self.begun = True
            self._fix = fix

    def update(self, raw: Estimate, step_s: float, flow: bool) -> Estimate:
        """The dead-reckoned estimate, mended. ``flow``: its velocity is measured as well."""
        self._past.append(raw)
        while raw.time_s - self._past[0].time_s > MEMORY_S:
            self._past.popleft()
        self._flow = flow
        haste = 1.0 if flow else _HASTE
        self.north.predict(step_s, haste)
        self.east.predict(step_s, haste)
        self.down.predict(step_s)
        self.yaw.predict(step_s)
        for measured in self._intake.drain(self._mended(raw)):
            self._fuse(measured, raw)
        if self._fix is not None:
            self._fuse_fix(self._fix, raw)
            self._fix = None
        return self._mended(raw)

    def shift_velocity(self, north_m_s: float, east_m_s: float) -> None:
        """The dead-reckoned velocity was put right by as much, from one moment to the next."""
        self.north.rate -= north_m_s
        self.east.rate -= east_m_s

    def _mended(self, raw: Estimate) -> Estimate:
        north, east, down = raw.position_ned_m
        v_north, v_east, v_down = raw.velocity_ned_m_s
        return raw._replace(
            position_ned_m=(
                north - self.north.offset,
                east - self.east.offset,
                down - self.down.offset,
            ),
            velocity_ned_m_s=(
                v_north - self.north.rate,
                v_east - self.east.rate,
                v_down - self.down.rate,
            ),
            yaw_rad=wrap_angle_rad(raw.yaw_rad - self.yaw.offset),
        )

    # -- one sample ----------------------------------------------------------------------------

    def _fuse(self, seen: Measured, now: Estimate) -> None:
        if seen.sample.reset_counter != self._reset_counter:
            self._reset_counter = seen.sample.reset_counter
            self._level_use.seen_s = self._height_use.seen_s = self._yaw_use.seen_s = -math.inf
        wanted = int(self._parameters["EKF2_EV_CTRL"])
        then, lag_s = self._past_at(seen.time_s), now.time_s - seen.time_s
        if wanted & _YAW_BIT and seen.yaw_rad == seen.yaw_rad:
            self._fuse_yaw(seen, then, lag_s, now.time_s)
        if seen.position_ned_m[0] == seen.position_ned_m[0]:
            if wanted & _LEVEL_BIT:
                self._fuse_level(seen, then, lag_s, now.time_s)
            if wanted & _DOWN_BIT:
                self._fuse_down(seen, then, lag_s, now.time_s)
        if wanted & _VELOCITY_BIT and seen.velocity_ned_m_s[0] == seen.velocity_ned_m_s[0]:
            self._fuse_velocity(seen, then, now.time_s)

    def _fuse_level(self, seen: Measured, then: Estimate, lag_s: float, now_s: float) -> None:
        errors = [then.position_ned_m[axis] - seen.position_ned_m[axis] for axis in (0, 1)]
        variances = self._variances(seen.sample.position_variance_m2, "EKF2_EVP_NOISE")
        axes = self.north, self.east
        if self._level_use.begins(now_s, self._patience_s):
            for axis, error, variance in zip(axes, errors, variances, strict=False):
                axis.move(error + lag_s * axis.rate, variance)
            self.resets += 1
            self._level_use.used_s = now_s
            return
        gate = self._parameters["EKF2_EVP_GATE"]
        ratio = max(
            axis.offset_ratio(error, lag_s, variance, gate)
            for axis, error, variance in zip(axes, errors, variances, strict=False)
        )
        self.ratios = self.ratios._replace(level=ratio)
        if ratio <= 1.0:
            for axis, error, variance in zip(axes, errors, variances, strict=False):
                axis.fuse_offset(error, lag_s, variance)
            self._level_use.used_s = now_s

    def _fuse_down(self, seen: Measured, then: Estimate, lag_s: float, now_s: float) -> None:
        """Unless vision is the reference of height, only its changes count, as in PX4."""
        down, error_m = self.down, then.position_ned_m[2] - seen.position_ned_m[2]
        variance = self._variances(seen.sample.position_variance_m2, "EKF2_EVP_NOISE")[2]
        if self._height_use.begins(now_s, self._patience_s):
            if self._parameters["EKF2_HGT_REF"] == _VISION_HEIGHT:
                self._height_bias_m = 0.0
                down.move(error_m, variance)
                self.resets += 1
            else:
                self._height_bias_m = error_m - down.offset
                down.move(down.offset, variance)
            self._height_use.used_s = now_s
            return
        error_m -= self._height_bias_m
        ratio = down.offset_ratio(error_m, lag_s, variance, self._parameters["EKF2_EVP_GATE"])
        self.ratios = self.ratios._replace(down=ratio)
        if ratio <= 1.0:
            down.fuse_offset(error_m, lag_s, variance)
            self._height_use.used_s = now_s

    def _fuse_yaw(self, seen: Measured, then: Estimate, lag_s: float, now_s: float) -> None:
        axis = self.yaw
        error_rad = axis.offset + wrap_angle_rad(then.yaw_rad - seen.yaw_rad - axis.offset)
        variance = self._bounded(seen.sample.yaw_variance_rad2, "EKF2_EVA_NOISE")
        if self._yaw_use.begins(now_s, self._patience_s):
            axis.move(error_rad, variance)
        elif axis.offset_ratio(error_rad, lag_s, variance, _YAW_GATE) <= 1.0:
            axis.fuse_offset(error_rad, lag_s, variance)
        else:
            return
        self._yaw_use.used_s = now_s

    def _fuse_velocity(self, seen: Measured, then: Estimate, now_s: float) -> None:
        variances = self._variances(seen.sample.velocity_variance_m2_s2, "EKF2_EVV_NOISE")
        errors = [
            was - seen_m_s
            for was, seen_m_s in zip(then.velocity_ned_m_s, seen.velocity_ned_m_s, strict=True)
        ]
        axes = self.north, self.east, self.down
        gate = self._parameters["EKF2_EVV_GATE"]
        ratio = max(
            axis.rate_ratio(error, variance, gate)
            for axis, error, variance in zip(axes, errors, variances, strict=True)
        )
        self.ratios = self.ratios._replace(velocity=ratio)
        # While flow measures the velocity as well, nothing forces it on what does not fit.
        begins = self._velocity_use.begins(now_s, self._patience_s) and not self._flow
        if begins or ratio <= 1.0:
            for axis, error, variance in zip(axes, errors, variances, strict=True):
                axis.fuse_rate(error, variance)
            self._velocity_use.used_s = now_s

    def _fuse_fix(self, fix: Fix, raw: Estimate) -> None:
        """Satellites know where home is, so that nothing jumps to what they see."""
        if raw.time_s - self._seen_s < _QUIET_S:
            return
        wanted = int(self._parameters["EKF2_GPS_CTRL"])
        place = self._parameters["EKF2_GPS_P_NOISE"] ** 2, self._parameters["EKF2_GPS_P_GATE"]
        speed = self._parameters["EKF2_GPS_V_NOISE"] ** 2, self._parameters["EKF2_GPS_V_GATE"]
        for number, axis in enumerate((self.north, self.east)):
            error_m = raw.position_ned_m[number] - fix.position_ned_m[number]
            error_m_s = raw.velocity_ned_m_s[number] - fix.velocity_ned_m_s[number]
            if wanted & _FIX_BIT and axis.offset_ratio(error_m, 0.0, *place) <= 1.0:
                axis.fuse_offset(error_m, 0.0, place[0])
                self._fix_used_s = raw.time_s
            if wanted & _VELOCITY_BIT and axis.rate_ratio(error_m_s, *speed) <= 1.0:
                axis.fuse_rate(error_m_s, speed[0])
                self._fix_used_s = raw.time_s

    # -- small questions -----------------------------------------------------------------------

    @property
    def _patience_s(self) -> float:
        return self._parameters["EKF2_NOAID_TOUT"] * 1e-6

    def _variances(self, claimed: tuple[float, float, float], name: str) -> list[float]:
        return [self._bounded(variance, name) for variance in claimed]

    def _bounded(self, claimed: float, name: str) -> float:
        """The variance that a client claims, but no less than the parameter's."""
        least = self._parameters[name] ** 2
        by_message = self._parameters["EKF2_EV_NOISE_MD"] == 0
        believed = by_message and claimed == claimed  # not NaN
        return max(least, min(claimed, _VAGUEST)) if believed else least

    def _past_at(self, time_s: float) -> Estimate:
        """Dead reckoning at that time, from the update before it."""
        before = next((past for past in reversed(self._past) if past.time_s <= time_s), None)
        return self._past[0] if before is None else _moved(before, time_s - before.time_s)


def _moved(state: Estimate, duration_s: float) -> Estimate:
    """A little later, motion going on as it is."""
    north_m, east_m, down_m = (
        place_m + speed_m_s * duration_s
        for place_m, speed_m_s in zip(state.position_ned_m, state.velocity_ned_m_s, strict=True)
    )
    yaw_rad = state.yaw_rad + state.rates_frd_rad_s[2] * duration_s
    return state._replace(position_ned_m=(north_m, east_m, down_m), yaw_rad=yaw_rad)
