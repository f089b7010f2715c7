"""The last word on every setpoint: limits, geofence, and what to do when data grows stale."""

import math
from enum import IntEnum
from typing import Annotated, NamedTuple

from msgspec import Meta

from companion.kernel.frames import ned_from_hfrd
from companion.kernel.messages import Setpoint, Telemetry
from companion.kernel.settings import Settings

Positive = Annotated[float, Meta(gt=0)]


class SafetySettings(Settings, frozen=True):
    """``[safety]``: no setpoint leaves the companion outside of these."""

    max_speed_m_s: Annotated[float, Meta(gt=0, le=5)] = 1.0
    max_climb_m_s: Annotated[float, Meta(gt=0, le=3)] = 0.7
    max_yaw_rate_deg_s: Annotated[float, Meta(gt=0, le=360)] = 90.0
    geofence_radius_m: Positive = 20.0
    """Around home; outwards velocity is taken away beyond it."""
    geofence_height_m: Positive = 3.0
    """Above home; climbing is taken away beyond it."""
    geofence_grace_m: Positive = 1.0
    """This far outside the fence the flight is over: land."""
    stop_after_s: Positive = 0.5
    """Age of the newest percept or telemetry at which velocity becomes zero."""
    hold_after_s: Positive = 2.0
    land_after_s: Positive = 5.0
    min_battery_norm: Annotated[float, Meta(ge=0, lt=1)] = 0.1
    """Land below this charge."""


class Reaction(IntEnum):
    """What the safety layer asks for, in rising order."""

    FLY = 0
    STOP = 1
    HOLD = 2
    LAND = 3


class Verdict(NamedTuple):
    """The setpoint that may be sent, and the reaction with its reason ("" while flying)."""

    setpoint: Setpoint
    reaction: Reaction
    reason: str


def react_to_age(age_s: float, settings: SafetySettings) -> Reaction:
    """The reaction to data of this age; an unknown age (NaN) is as bad as the oldest."""
    if age_s < settings.stop_after_s:
        return Reaction.FLY
    if age_s < settings.hold_after_s:
        return Reaction.STOP
    if age_s < settings.land_after_s:
        return Reaction.HOLD
    return Reaction.LAND


def check(setpoint: Setpoint, telemetry: Telemetry, settings: SafetySettings) -> Verdict:
    """Makes any setpoint safe to send; see SafetySettings for the limits.

    Values that are not finite become a stop. The result is within the limits whatever comes in.
    """
    values = (*setpoint.velocity_hfrd_m_s, setpoint.yaw_rate_rad_s)
    state = (*telemetry.position_ned_m, telemetry.yaw_rad)
    if not all(map(math.isfinite, values)):
        return Verdict(_stop(setpoint.stamp_ns), Reaction.STOP, "setpoint is not finite")
    if not all(map(math.isfinite, state)):
        return Verdict(_stop(setpoint.stamp_ns), Reaction.STOP, "no valid position estimate")
    if telemetry.battery_norm < settings.min_battery_norm:
        percent = 100 * telemetry.battery_norm
        return Verdict(_stop(setpoint.stamp_ns), Reaction.LAND, f"battery at {percent:.0f} %")
    limited = _limit(setpoint, settings)
    return _fence(limited, telemetry, settings)


def _stop(stamp_ns: int) -> Setpoint:
    return Setpoint(stamp_ns=stamp_ns)


def _limit(setpoint: Setpoint, settings: SafetySettings) -> Setpoint:
    forward, right, down = setpoint.velocity_hfrd_m_s
    speed_m_s = math.hypot(forward, right)
    if speed_m_s > settings.max_speed_m_s:
        # Two steps, since the quotient of a tiny limit and a huge speed may underflow to zero.
        forward = forward / speed_m_s * settings.max_speed_m_s
        right = right / speed_m_s * settings.max_speed_m_s
    down = max(-settings.max_climb_m_s, min(settings.max_climb_m_s, down))
    limit_rad_s = math.radians(settings.max_yaw_rate_deg_s)
    return Setpoint(
        stamp_ns=setpoint.stamp_ns,
        velocity_hfrd_m_s=(forward, right, down),
        yaw_rate_rad_s=max(-limit_rad_s, min(limit_rad_s, setpoint.yaw_rate_rad_s)),
    )


def _fence(setpoint: Setpoint, telemetry: Telemetry, settings: SafetySettings) -> Verdict:
    north_m, east_m, down_m = telemetry.position_ned_m
    distance_m, height_m = math.hypot(north_m, east_m), -down_m
    outside_m = max(distance_m - settings.geofence_radius_m, height_m - settings.geofence_height_m)
    if outside_m <= 0.0:
        return Verdict(setpoint, Reaction.FLY, "")
    forward, right, down = setpoint.velocity_hfrd_m_s
    v_north, v_east = ned_from_hfrd(forward, right, telemetry.yaw_rad)
    leaves = v_north * north_m + v_east * east_m > 0.0
    if distance_m > settings.geofence_radius_m and leaves:
        forward = right = 0.0
    if height_m > settings.geofence_height_m:
        down = max(0.0, down)
    inward = Setpoint(
        stamp_ns=setpoint.stamp_ns,
        velocity_hfrd_m_s=(forward, right, down),
        yaw_rate_rad_s=setpoint.yaw_rate_rad_s,
    )
    reaction = Reaction.LAND if outside_m > settings.geofence_grace_m else Reaction.FLY
    return Verdict(inward, reaction, f"{outside_m:.1f} m outside the geofence")
