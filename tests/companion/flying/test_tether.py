"""Zones of the ground plan, and the way back into them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.flying.behaviour import Behaviour, BehaviourSettings
from companion.flying.tether import ZoneSettings, way_back_rad
from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import BehaviourState

FRAME_NS = 100_000_000
HERE = ZoneSettings(from_s=0.0, centre_m=(0.0, 0.0), radius_m=2.0)
THERE = ZoneSettings(from_s=60.0, centre_m=(6.0, 0.0), radius_m=2.0)
ZONES = (THERE, HERE)


@pytest.mark.parametrize(
    ("elapsed_s", "place_m", "wanted_rad"),
    [
        (0.0, (0.0, 0.0), None),
        (0.0, (1.0, 1.0), None),
        (0.0, (3.0, 0.0), math.pi),
        (0.0, (0.0, -3.0), math.pi / 2),
        (59.9, (6.0, 0.0), math.pi),
        (60.0, (6.0, 0.0), None),
        (60.0, (0.0, 0.0), 0.0),
        (60.0, (math.nan, 0.0), None),
    ],
)
def test_the_way_back_leads_to_the_centre_of_the_zone_that_holds(elapsed_s, place_m, wanted_rad):
    assert way_back_rad(ZONES, elapsed_s, *place_m) == wanted_rad


def test_without_a_zone_there_is_no_way_back():
    assert way_back_rad((), 10.0, 50.0, 50.0) is None
    assert way_back_rad((THERE,), 10.0, 50.0, 50.0) is None


def make(seed=0):
    return Behaviour(BehaviourSettings(), np.random.default_rng(seed))


def test_out_of_its_zone_it_turns_to_the_way_back_by_the_shorter_side():
    behaviour = make()
    behaviour.step(0, False, 0.5)
    goal = behaviour.step(FRAME_NS, False, 0.5, way_back_rad=-1.0)
    assert behaviour.state is BehaviourState.ROTATE
    assert goal.heading_rad == pytest.approx(-1.0)
    assert goal.turn_sign == -1
    assert behaviour.step(2 * FRAME_NS, False, -1.0, way_back_rad=-1.0).forward_speed_m_s > 0.0


def test_on_the_way_back_it_flies_on():
    behaviour = make()
    behaviour.step(0, False, 0.5)
    assert behaviour.step(FRAME_NS, False, 0.5, way_back_rad=0.6).forward_speed_m_s > 0.0


@given(seed=st.integers(0, 200), back_rad=st.floats(-math.pi, math.pi))
def test_what_blocks_the_way_back_is_passed_without_leading_further_away(seed, back_rad):
    behaviour = make(seed)
    heading_rad = behaviour.step(0, True, back_rad, way_back_rad=back_rad).heading_rad
    assert abs(wrap_angle_rad(heading_rad - back_rad)) <= math.pi / 2 + 1e-9
    behaviour.step(FRAME_NS, False, heading_rad, way_back_rad=back_rad)
    assert behaviour.state is BehaviourState.STRAIGHT
    behaviour.step(20 * FRAME_NS, False, heading_rad, way_back_rad=back_rad)
    assert behaviour.state is BehaviourState.STRAIGHT  # a detour lasts
    behaviour.step(31 * FRAME_NS, False, heading_rad, way_back_rad=back_rad)
    astray = abs(wrap_angle_rad(heading_rad - back_rad)) > math.radians(20)
    assert (behaviour.state is BehaviourState.ROTATE) == astray
