"""How sure the cue is, and how fast it may fly for it."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.flying.behaviour import BehaviourSettings
from companion.flying.certainty import certainty_norm, with_speed_for
from companion.flying.switch import Choice
from companion.kernel.messages import Cue, Goal, Percept

FAST, FLOOR = 0.5, 0.1
SETTINGS = BehaviourSettings(forward_speed_m_s=FAST, speed_floor_m_s=FLOOR)
FIGURE = st.floats(0, 30) | st.just(math.nan)


def certainty(mono_px=1.0, std_px=0.5, novelty=math.nan, cue=Cue.MONO, threshold_px=4.0):
    percept = Percept(
        stamp_ns=0,
        stereo_px=1.0,
        stereo_valid_norm=1.0,
        mono_px=mono_px,
        mono_std_px=std_px,
        mono_novelty=novelty,
    )
    return certainty_norm(Choice(cue, False, mono_px, threshold_px, False), percept)


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({"mono_px": 3.0}, 1.0),
        ({"mono_px": 3.5}, 0.5),
        ({"mono_px": 4.0}, 0.0),
        ({"mono_px": 5.0}, 0.0),
        ({"mono_px": 3.0, "std_px": 2.0}, 0.25),
        ({"mono_px": 3.0, "std_px": 0.0}, 1.0),
        ({"std_px": math.nan}, 0.0),
        ({"mono_px": math.nan}, 0.0),
        ({"novelty": 1.0}, 1.0),
        ({"novelty": 1.5}, 0.5),
        ({"novelty": 3.0}, 0.0),
        ({"cue": Cue.STEREO, "mono_px": 9.0, "std_px": math.nan}, 1.0),
        ({"cue": Cue.NONE}, 0.0),
    ],
)
def test_it_is_certain_two_deviations_below_the_threshold_of_what_it_knows(changes, wanted):
    assert certainty(**changes) == pytest.approx(wanted)


@given(mono_px=FIGURE, std_px=FIGURE, novelty=FIGURE, speed_m_s=st.floats(0, FAST))
def test_speed_stays_between_floor_and_plan_and_never_grows(mono_px, std_px, novelty, speed_m_s):
    sure = certainty(mono_px, std_px, novelty)
    assert 0.0 <= sure <= 1.0
    goal = with_speed_for(
        Goal(forward_speed_m_s=speed_m_s, heading_rad=1.0, turn_sign=1), sure, SETTINGS
    )
    assert (goal.heading_rad, goal.turn_sign) == (1.0, 1)
    assert goal.forward_speed_m_s <= speed_m_s
    assert goal.forward_speed_m_s >= min(speed_m_s, FLOOR)


def test_the_floor_and_the_plans_speed_are_reached():
    goal = Goal(forward_speed_m_s=FAST, heading_rad=0.0, turn_sign=0)
    speeds_m_s = [
        with_speed_for(goal, sure, SETTINGS).forward_speed_m_s for sure in (0.0, 0.5, 1.0)
    ]
    assert speeds_m_s == pytest.approx([FLOOR, 0.3, FAST])
