"""What wind does to a vehicle that follows velocities, and what is asked of it then."""

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.flying.push_back import PushBack, PushBackSettings, Pushed
from companion.kernel.messages import Setpoint, Telemetry

PERIOD_NS, STEPS = 100_000_000, 50
SPEED_M_S = 0.5
WIND_S = (2.0, 4.0)
"""When it blows."""
LEFT_ALONE = PushBackSettings(gain_norm=0.0)


class Plant:
    """One axis: follows setpoints as a delayed second-order lag, and learns a steady wind."""

    def __init__(self, rate_rad_s=4.0, damping=0.7, delay_frames=2, learns_per_s=0.2):
        self.rate_rad_s, self.damping, self.delay_frames = rate_rad_s, damping, delay_frames
        self.learns_per_s = learns_per_s
        self.north_m = self.v_m_s = self.a_m_s2 = self.learned_m_s = 0.0
        self.asked = []

    def fly(self, asked_m_s, wind_m_s):
        """One frame on; ``wind_m_s``: the velocity that it carries the vehicle with."""
        self.asked.append(asked_m_s)
        heard_m_s = self.asked[max(0, len(self.asked) - 1 - self.delay_frames)]
        step_s = PERIOD_NS * 1e-9 / STEPS
        for _ in range(STEPS):
            self.learned_m_s += step_s * self.learns_per_s * (heard_m_s - self.v_m_s)
            wanted_m_s = heard_m_s + wind_m_s + self.learned_m_s
            pull = self.rate_rad_s**2 * (wanted_m_s - self.v_m_s)
            self.a_m_s2 += step_s * (pull - 2 * self.damping * self.rate_rad_s * self.a_m_s2)
            self.v_m_s += step_s * self.a_m_s2
            self.north_m += step_s * self.v_m_s


def telemetry(stamp_ns, v_north_m_s, yaw_rad=0.0):
    return Telemetry(
        stamp_ns=stamp_ns,
        position_ned_m=(0.0, 0.0, -1.0),
        velocity_ned_m_s=(v_north_m_s, 0.0, 0.0),
        yaw_rad=yaw_rad,
    )


def fly(settings, plant, wanted=lambda _: 0.0, wind_m_s=0.0, seconds=15.0):
    """What was asked of the autopilot, and where the vehicle was, a row per frame."""
    push_back, rows = PushBack(settings, SPEED_M_S), []
    for number in range(round(seconds * 1e9 / PERIOD_NS)):
        stamp_ns = number * PERIOD_NS
        blows = WIND_S[0] <= stamp_ns * 1e-9 < WIND_S[1]
        wish = Setpoint(stamp_ns=stamp_ns, velocity_hfrd_m_s=(wanted(stamp_ns * 1e-9), 0.0, 0.1))
        asked = push_back.against(wish, telemetry(stamp_ns, plant.v_m_s)).setpoint
        push_back.sent(asked, 0.0)
        plant.fly(asked.velocity_hfrd_m_s[0], wind_m_s if blows else 0.0)
        rows.append((asked.velocity_hfrd_m_s[0] - wish.velocity_hfrd_m_s[0], plant.north_m))
    return rows


def furthest_m(rows):
    return max(abs(north_m) for _, north_m in rows)


def test_a_gust_carries_the_vehicle_half_as_far():
    alone = fly(LEFT_ALONE, Plant(), wind_m_s=0.75)
    helped = fly(PushBackSettings(), Plant(), wind_m_s=0.75)
    assert furthest_m(alone) == pytest.approx(1.3, abs=0.1)
    assert furthest_m(helped) < 0.5 * furthest_m(alone)


@given(rate_rad_s=st.floats(3.0, 6.0), damping=st.floats(0.5, 1.0), delay_frames=st.integers(1, 3))
def test_a_vehicle_that_follows_otherwise_is_helped_too_and_comes_to_rest(
    rate_rad_s, damping, delay_frames
):
    alone, plant = (
        Plant(rate_rad_s, damping, delay_frames),
        Plant(rate_rad_s, damping, delay_frames),
    )
    without = fly(LEFT_ALONE, alone, wind_m_s=0.75)
    assert furthest_m(fly(PushBackSettings(), plant, wind_m_s=0.75)) < 0.8 * furthest_m(without)
    assert abs(plant.v_m_s) < 0.1


@given(rate_rad_s=st.floats(3.0, 6.0), speed_m_s=st.floats(0.0, SPEED_M_S))
def test_without_wind_it_asks_for_nothing_else(rate_rad_s, speed_m_s):
    def in_steps(time_s):
        return speed_m_s if time_s % 3.0 < 1.5 else 0.0

    assert all(extra == 0.0 for extra, _ in fly(PushBackSettings(), Plant(rate_rad_s), in_steps))


def test_a_vehicle_that_cannot_go_on_is_not_pushed_on():
    push_back = PushBack(PushBackSettings(), SPEED_M_S)
    for number in range(30):
        ahead = Setpoint(stamp_ns=number * PERIOD_NS, velocity_hfrd_m_s=(0.5, 0.0, 0.0))
        told = telemetry(number * PERIOD_NS, 0.0)
        assert push_back.against(ahead, told) == Pushed(ahead)
        push_back.sent(ahead, 0.0)


def pushed(**changed):
    """What a vehicle is asked that shall stand still, stood still, and is now said to move."""
    push_back = PushBack(PushBackSettings(), SPEED_M_S)
    for number in range(2):
        push_back.against(Setpoint(stamp_ns=number * PERIOD_NS), telemetry(number * PERIOD_NS, 0.0))
        push_back.sent(Setpoint(stamp_ns=number * PERIOD_NS), 0.0)
    told = telemetry(2 * PERIOD_NS, 0.8)
    still = Setpoint(stamp_ns=2 * PERIOD_NS)
    return push_back.against(still, msgspec.structs.replace(told, **changed))


def test_it_pushes_where_the_wind_comes_from_whatever_the_yaw():
    assert pushed().setpoint.velocity_hfrd_m_s == pytest.approx((-0.72, 0.0, 0.0))
    east = pushed(yaw_rad=math.pi / 2).setpoint.velocity_hfrd_m_s
    assert east == pytest.approx((0.0, 0.72, 0.0))


@pytest.mark.parametrize(
    ("gain_norm", "done"), [(0.5, "pushes back"), (0.0, "left to the autopilot")]
)
def test_it_is_told_once_a_gust(gain_norm, done):
    push_back, told = PushBack(PushBackSettings(gain_norm=gain_norm), SPEED_M_S), []
    for number in range(60):
        v_m_s = 0.5 if 10 <= number < 20 or number >= 50 else 0.0
        still = Setpoint(stamp_ns=number * PERIOD_NS)
        told.append(push_back.against(still, telemetry(number * PERIOD_NS, v_m_s)).event)
        push_back.sent(still, 0.0)
    assert [number for number, event in enumerate(told) if event] == [10, 50]
    assert told[10].text == f"wind: carried off at 0.5 m/s towards 000 deg; {done}"


@pytest.mark.parametrize(
    "changed",
    [
        {"velocity_ned_m_s": (math.nan, 0.0, 0.0)},
        {"velocity_ned_m_s": (math.inf, 0.0, 0.0)},
        {"velocity_ned_m_s": (0.29, 0.0, 0.0)},
        {"stamp_ns": 0},
    ],
    ids=["unknown", "infinite", "as the model may err", "of 0.2 s ago"],
)
def test_it_leaves_alone_what_it_does_not_know(changed):
    assert pushed(**changed) == Pushed(Setpoint(stamp_ns=2 * PERIOD_NS))


@given(st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 3), st.floats(-10, 10))
def test_whatever_the_velocity_it_adds_no_more_than_allowed(velocity_ned_m_s, yaw_rad):
    setpoint = pushed(velocity_ned_m_s=velocity_ned_m_s, yaw_rad=yaw_rad).setpoint
    forward_m_s, right_m_s, down_m_s = setpoint.velocity_hfrd_m_s
    assert math.hypot(forward_m_s, right_m_s) <= 0.8 + 1e-9
    assert down_m_s == 0.0
