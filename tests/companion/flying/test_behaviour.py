"""The state machine of paper section III-D, state by state."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.flying.behaviour import Behaviour, BehaviourSettings
from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import BehaviourState, Goal

FRAME_NS = 100_000_000


def make(seed=0, **settings):
    return Behaviour(BehaviourSettings(**settings), np.random.default_rng(seed))


def turn_to(behaviour, goal, blocked, stamp_ns=0):
    """The next frame, with the vehicle facing where it was asked to."""
    return behaviour.step(stamp_ns, blocked, goal.heading_rad)


def test_flies_ahead_on_the_first_heading_while_clear():
    behaviour = make(forward_speed_m_s=0.5)
    goals = [behaviour.step(i * FRAME_NS, False, 0.3 + 0.01 * i) for i in range(5)]
    assert all(goal.forward_speed_m_s == 0.5 for goal in goals)
    assert all(goal.heading_rad == 0.3 for goal in goals)
    assert behaviour.state is BehaviourState.STRAIGHT


def test_blocked_stops_and_turns_towards_a_new_heading():
    behaviour = make()
    behaviour.step(0, False, 0.0)
    goal = behaviour.step(FRAME_NS, True, 0.0)
    assert behaviour.state is BehaviourState.ROTATE
    assert goal.forward_speed_m_s == 0.0
    assert goal.turn_sign == (1 if wrap_angle_rad(goal.heading_rad) > 0 else -1)


def test_rotation_ignores_the_obstacle_until_aligned():
    behaviour = make()
    goal = behaviour.step(0, True, 0.0)
    assert not behaviour.looks_ahead
    away = behaviour.step(FRAME_NS, False, wrap_angle_rad(goal.heading_rad + math.pi))
    assert behaviour.state is BehaviourState.ROTATE
    assert away.heading_rad == goal.heading_rad


def test_aligned_and_clear_flies_on():
    behaviour = make()
    goal = behaviour.step(0, True, 0.0)
    ahead = turn_to(behaviour, goal, blocked=False)
    assert behaviour.state is BehaviourState.STRAIGHT
    assert ahead.forward_speed_m_s > 0.0


@pytest.mark.parametrize("blocked", [True, None])
def test_aligned_but_not_clear_searches_on_the_same_way(blocked):
    behaviour = make(seed=3)
    goal = behaviour.step(0, True, 0.0)
    search = turn_to(behaviour, goal, blocked)
    assert behaviour.state is BehaviourState.SEARCH
    assert math.isnan(search.heading_rad)
    assert search.turn_sign == goal.turn_sign
    assert search.forward_speed_m_s == 0.0
    clear = behaviour.step(2 * FRAME_NS, False, 1.0)
    assert behaviour.state is BehaviourState.STRAIGHT
    assert clear.heading_rad == 1.0


def search(behaviour, turned_rad, blocked=True, stamp_ns=0):
    """From the frame that blocks the way: so far round, in steps of a twentieth of a circle."""
    goal = behaviour.step(stamp_ns, True, 0.0)
    turn_to(behaviour, goal, blocked, stamp_ns)
    yaw_rad = goal.heading_rad
    for _ in range(round(turned_rad / (math.tau / 20))):
        yaw_rad = wrap_angle_rad(yaw_rad + math.tau / 20)
        behaviour.step(stamp_ns, blocked, yaw_rad)
    return yaw_rad


def test_a_search_is_in_vain_after_a_full_circle():
    behaviour = make()
    search(behaviour, 0.9 * math.tau)
    assert not behaviour.searched_in_vain
    assert behaviour.state is BehaviourState.SEARCH
    behaviour = make()
    search(behaviour, 1.1 * math.tau)
    assert behaviour.searched_in_vain
    assert behaviour.state is BehaviourState.SEARCH


def test_two_searches_with_a_way_between_them_are_none_in_vain():
    behaviour = make()
    for stamp_ns in (0, 10 * FRAME_NS):
        yaw_rad = search(behaviour, 0.8 * math.tau, stamp_ns=stamp_ns)
        for frame in (1, 2):
            behaviour.step(stamp_ns + frame * FRAME_NS, False, yaw_rad)
        assert not behaviour.searched_in_vain


def test_after_a_search_in_vain_it_must_leave_the_place():
    behaviour = make()
    yaw_rad = search(behaviour, 1.1 * math.tau)
    ahead_ns = [frame * FRAME_NS for frame in range(1, 22)]
    in_vain = []
    for stamp_ns in ahead_ns:
        behaviour.step(stamp_ns, False, yaw_rad)
        in_vain.append(behaviour.searched_in_vain)
    assert behaviour.state is BehaviourState.STRAIGHT
    assert in_vain == [True] * 20 + [False]


def test_unknown_distance_stops_at_once_and_turns_after_the_limit():
    behaviour = make(unknown_limit_s=1.0)
    behaviour.step(0, False, 0.0)
    for i in range(1, 12):
        goal = behaviour.step(i * FRAME_NS, None, 0.0)
        assert goal.forward_speed_m_s == 0.0
        assert behaviour.state is BehaviourState.STRAIGHT
    behaviour.step(12 * FRAME_NS, None, 0.0)
    assert behaviour.state is BehaviourState.ROTATE


def test_new_headings_cover_the_circle_evenly():
    headings = []
    for seed in range(400):
        headings.append(make(seed).step(0, True, 2.0).heading_rad)
    quarters = np.histogram(headings, bins=4, range=(-math.pi, math.pi))[0]
    assert quarters.min() > 70


@pytest.mark.parametrize("freer_sign", [1, -1])
def test_asked_to_it_turns_to_the_freer_side_as_far_as_it_would_have(freer_sign):
    for seed in range(30):
        goals = [
            make(seed, turn_to=side).step(0, True, 0.0, freer_sign) for side in ("freer", "random")
        ]
        assert goals[0].turn_sign == freer_sign
        assert abs(goals[0].heading_rad) == pytest.approx(abs(goals[1].heading_rad))


def test_where_no_side_is_known_to_be_freer_it_turns_to_either():
    signs = {make(seed, turn_to="freer").step(0, True, 0.0).turn_sign for seed in range(20)}
    assert signs == {1, -1}


@given(
    blocked=st.lists(st.sampled_from([True, False, None]), min_size=1, max_size=60),
    yaw_rad=st.floats(-math.pi, math.pi),
)
def test_never_moves_ahead_unless_the_way_is_known_to_be_clear(blocked, yaw_rad):
    behaviour = make()
    for i, state in enumerate(blocked):
        goal = behaviour.step(i * FRAME_NS, state, yaw_rad)
        assert isinstance(goal, Goal)
        assert goal.forward_speed_m_s == 0.0 or state is False
