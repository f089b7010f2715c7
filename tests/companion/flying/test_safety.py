"""The last word on every setpoint."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.flying.safety import Reaction, SafetySettings, check, react_to_age
from companion.kernel.frames import ned_from_hfrd
from companion.kernel.messages import Setpoint, Telemetry

SETTINGS = SafetySettings()
HOVER = Telemetry(position_ned_m=(0.0, 0.0, -1.2), yaw_rad=0.0, battery_norm=0.8)
any_float = st.floats(allow_nan=True, allow_infinity=True)


def setpoint(forward=0.0, right=0.0, down=0.0, yaw_rate=0.0):
    return Setpoint(stamp_ns=1, velocity_hfrd_m_s=(forward, right, down), yaw_rate_rad_s=yaw_rate)


def at(north_m=0.0, east_m=0.0, down_m=-1.2, yaw_rad=0.0, battery_norm=0.8):
    return Telemetry(
        position_ned_m=(north_m, east_m, down_m), yaw_rad=yaw_rad, battery_norm=battery_norm
    )


@given(
    velocity=st.tuples(any_float, any_float, any_float),
    yaw_rate=any_float,
    position=st.tuples(any_float, any_float, any_float),
    yaw=any_float,
    battery=any_float,
)
def test_whatever_comes_in_what_goes_out_is_within_limits(
    velocity, yaw_rate, position, yaw, battery
):
    telemetry = Telemetry(position_ned_m=position, yaw_rad=yaw, battery_norm=battery)
    wanted = Setpoint(stamp_ns=1, velocity_hfrd_m_s=velocity, yaw_rate_rad_s=yaw_rate)
    sent = check(wanted, telemetry, SETTINGS).setpoint
    forward, right, down = sent.velocity_hfrd_m_s
    assert math.hypot(forward, right) <= SETTINGS.max_speed_m_s * (1 + 1e-9)
    assert abs(down) <= SETTINGS.max_climb_m_s
    assert abs(sent.yaw_rate_rad_s) <= math.radians(SETTINGS.max_yaw_rate_deg_s) + 1e-12


@given(
    bearing=st.floats(-math.pi, math.pi),
    yaw=st.floats(-math.pi, math.pi),
    forward=st.floats(-1, 1),
    right=st.floats(-1, 1),
)
def test_outside_the_fence_nothing_flies_further_out(bearing, yaw, forward, right):
    radius_m = SETTINGS.geofence_radius_m + 0.5
    north_m, east_m = radius_m * math.cos(bearing), radius_m * math.sin(bearing)
    sent = check(setpoint(forward, right), at(north_m, east_m, yaw_rad=yaw), SETTINGS).setpoint
    v_north, v_east = ned_from_hfrd(*sent.velocity_hfrd_m_s[:2], yaw)
    assert v_north * north_m + v_east * east_m <= 1e-9


def test_inside_the_limits_nothing_changes():
    wanted = setpoint(0.5, 0.0, -0.1, 0.3)
    verdict = check(wanted, HOVER, SETTINGS)
    assert verdict.setpoint == wanted
    assert verdict.reaction is Reaction.FLY


def test_above_the_fence_it_may_only_sink():
    assert check(setpoint(down=-0.5), at(down_m=-3.2), SETTINGS).setpoint.velocity_hfrd_m_s[2] == 0
    sinking = check(setpoint(down=0.5), at(down_m=-3.2), SETTINGS).setpoint
    assert sinking.velocity_hfrd_m_s[2] == 0.5


@pytest.mark.parametrize(
    ("telemetry", "reaction"),
    [
        (HOVER, Reaction.FLY),
        (at(north_m=20.5), Reaction.FLY),
        (at(north_m=21.5), Reaction.LAND),
        (at(battery_norm=0.05), Reaction.LAND),
        (at(battery_norm=math.nan), Reaction.FLY),
        (at(north_m=math.nan), Reaction.STOP),
    ],
)
def test_reaction_to_the_state(telemetry, reaction):
    verdict = check(setpoint(0.5), telemetry, SETTINGS)
    assert verdict.reaction is reaction
    assert (verdict.reason == "") == (telemetry in (HOVER, at(battery_norm=math.nan)))


@pytest.mark.parametrize(
    ("age_s", "reaction"),
    [
        (0.0, Reaction.FLY),
        (0.49, Reaction.FLY),
        (0.5, Reaction.STOP),
        (2.0, Reaction.HOLD),
        (5.0, Reaction.LAND),
        (math.nan, Reaction.LAND),
    ],
)
def test_stale_data_stops_then_holds_then_lands(age_s, reaction):
    assert react_to_age(age_s, SETTINGS) is reaction
