"""From goal to setpoint."""

import math

import pytest

from companion.flying.pilot import PilotSettings, fly_to
from companion.kernel.messages import NAN, Goal, Telemetry


def command(goal, *, down_m=-1.2, yaw_rad=0.0):
    telemetry = Telemetry(position_ned_m=(0.0, 0.0, down_m), yaw_rad=yaw_rad)
    return fly_to(
        goal,
        telemetry,
        stamp_ns=7,
        height_m=1.2,
        yaw_rate_limit_rad_s=0.8,
        settings=PilotSettings(),
    )


def ahead(heading_rad=0.0):
    return Goal(forward_speed_m_s=0.5, heading_rad=heading_rad, turn_sign=0)


def test_at_height_and_on_heading_it_only_flies_ahead():
    sent = command(ahead())
    assert sent.velocity_hfrd_m_s == (0.5, 0.0, 0.0)
    assert sent.yaw_rate_rad_s == 0.0
    assert sent.stamp_ns == 7


@pytest.mark.parametrize(("down_m", "sign"), [(-0.5, -1), (-2.0, 1)])
def test_height_error_is_flown_back_within_the_climb_limit(down_m, sign):
    down_m_s = command(ahead(), down_m=down_m).velocity_hfrd_m_s[2]
    assert math.copysign(1, down_m_s) == sign
    assert abs(down_m_s) <= PilotSettings().climb_limit_m_s


def test_turns_the_shorter_way_across_the_wrap():
    assert command(ahead(-3.0), yaw_rad=3.0).yaw_rate_rad_s > 0
    assert command(ahead(3.0), yaw_rad=-3.0).yaw_rate_rad_s < 0


@pytest.mark.parametrize("sign", [-1, 1])
def test_search_turns_on_at_the_limit(sign):
    goal = Goal(forward_speed_m_s=0.0, heading_rad=NAN, turn_sign=sign)
    assert command(goal).yaw_rate_rad_s == sign * 0.8
