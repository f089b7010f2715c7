"""Offboard attitude and attitude rate: past the outer loops, straight to the airframe's."""

import math
from typing import Final

from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import NAN
from sitl.autopilot.control import AttitudeCommand
from sitl.autopilot.interface import AttitudeSetpoint, Estimate
from sitl.autopilot.parameters import Number

_TILT_LIMIT_RAD: Final = math.radians(55.0)  # short of where the failure detector strikes


def attitude_command(
    setpoint: AttitudeSetpoint, estimate: Estimate, parameters: dict[str, Number]
) -> AttitudeCommand:
    """Thrust is flown as it comes: nothing holds the height."""
    roll_rate, pitch_rate, yaw_rate = setpoint.rates_frd_rad_s
    yaw_rate_rad_s = 0.0 if math.isnan(yaw_rate) else yaw_rate
    if not math.isnan(setpoint.yaw_rad):
        error_rad = wrap_angle_rad(setpoint.yaw_rad - estimate.yaw_rad)
        yaw_rate_rad_s += parameters["MC_YAW_P"] * error_rad
    limit = math.radians(parameters["MPC_YAWRAUTO_MAX"])
    by_angle = not math.isnan(setpoint.roll_rad)
    return AttitudeCommand(
        _bounded(setpoint.roll_rad, _TILT_LIMIT_RAD) if by_angle else 0.0,
        _bounded(setpoint.pitch_rad, _TILT_LIMIT_RAD) if by_angle else 0.0,
        _bounded(yaw_rate_rad_s, limit),
        _share(setpoint.thrust_norm),
        NAN if by_angle else roll_rate,
        NAN if by_angle else pitch_rate,
    )


def _bounded(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


def _share(value: float) -> float:
    return 0.0 if math.isnan(value) else max(0.0, min(1.0, value))
