"""From a goal to a setpoint: speed ahead, yaw rate towards the heading, height held."""

import math
from typing import Annotated

from msgspec import Meta

from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import Goal, Setpoint, Telemetry
from companion.kernel.settings import Settings

Gain = Annotated[float, Meta(gt=0, le=10)]


class PilotSettings(Settings, frozen=True):
    """``[pilot]``: gains of the outer loops."""

    heading_gain_per_s: Gain = 1.5
    """Yaw rate per heading error; below the autopilot's own yaw bandwidth."""
    height_gain_per_s: Gain = 0.8
    """Climb rate per height error."""
    climb_limit_m_s: Annotated[float, Meta(gt=0, le=2)] = 0.4


def fly_to(
    goal: Goal,
    telemetry: Telemetry,
    *,
    stamp_ns: int,
    height_m: float,
    yaw_rate_limit_rad_s: float,
    settings: PilotSettings,
) -> Setpoint:
    """The setpoint that pursues ``goal`` at ``height_m`` above home.

    A NaN heading turns on at the limit in the goal's direction. Height is controlled on local z:
    PX4's relative altitude jumps by metres indoors.
    """
    error_m = height_m + telemetry.position_ned_m[2]
    climb_m_s = _clip(settings.height_gain_per_s * error_m, settings.climb_limit_m_s)
    return Setpoint(
        stamp_ns=stamp_ns,
        velocity_hfrd_m_s=(goal.forward_speed_m_s, 0.0, -climb_m_s),
        yaw_rate_rad_s=_yaw_rate_rad_s(goal, telemetry.yaw_rad, yaw_rate_limit_rad_s, settings),
    )


def _yaw_rate_rad_s(
    goal: Goal, yaw_rad: float, limit_rad_s: float, settings: PilotSettings
) -> float:
    if math.isnan(goal.heading_rad):
        return goal.turn_sign * limit_rad_s
    error_rad = wrap_angle_rad(goal.heading_rad - yaw_rad)
    return _clip(settings.heading_gain_per_s * error_rad, limit_rad_s)


def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
