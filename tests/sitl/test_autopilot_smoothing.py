"""The references keep their limits, and arrive without overshoot, whatever is asked."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.autopilot.smoothing import SmoothSpeed, SmoothVelocity2

STEP_S = 0.02
SPEEDS = st.floats(-2.0, 2.0)
LIMITS = st.floats(0.5, 5.0)
JERKS = st.floats(2.0, 40.0)


@settings(max_examples=60)
@given(start=SPEEDS, target=SPEEDS, rise=LIMITS, fall=LIMITS, jerk=JERKS)
def test_one_axis(start, target, rise, fall, jerk):
    reference = SmoothSpeed(STEP_S)
    reference.reset(start)
    step_limit = jerk * STEP_S
    furthest, before = 0.0, 0.0
    for _ in range(1000):
        reference.step(target, rise, fall, jerk)
        assert -fall - step_limit <= reference.acceleration <= rise + step_limit
        assert abs(reference.acceleration - before) <= step_limit * 1.0001
        before = reference.acceleration
        furthest = max(furthest, math.copysign(1.0, target - start) * (reference.speed - target))
    assert reference.speed == target or abs(reference.speed - target) < 1e-3
    assert furthest < 0.05


@settings(max_examples=60)
@given(target=st.tuples(SPEEDS, SPEEDS), turn=st.floats(-3.0, 3.0), limit=LIMITS, jerk=JERKS)
def test_the_plane_has_no_faster_direction(target, turn, limit, jerk):
    """Turning the target turns the whole reference with it."""
    plain, turned = SmoothVelocity2(STEP_S, 0.15), SmoothVelocity2(STEP_S, 0.15)
    c, s = math.cos(turn), math.sin(turn)
    for _ in range(100):
        plain.step(*target, limit, jerk)
        turned.step(c * target[0] - s * target[1], s * target[0] + c * target[1], limit, jerk)
        north, east = plain.north_m_s, plain.east_m_s
        assert math.hypot(plain.north_m_s2, plain.east_m_s2) <= limit + 1e-9
        assert math.isclose(turned.north_m_s, c * north - s * east, abs_tol=1e-6)
        assert math.isclose(turned.east_m_s, s * north + c * east, abs_tol=1e-6)
