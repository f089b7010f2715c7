"""Missions, fences and rally points on board, without a link."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.kernel.messages import NAN, FlightMode
from sitl.autopilot.geofence import Circle, Polygon, allowed
from sitl.autopilot.interface import Ack
from sitl.autopilot.mission import (
    ChangeSpeed,
    Delay,
    Jump,
    LandAt,
    Mission,
    MissionState,
    ReturnToLaunch,
    TakeOffTo,
    TurnTo,
    Waypoint,
)
from sitl.settings import EstimatorSettings, SitlSettings

EXACT = SitlSettings(
    estimator=EstimatorSettings(velocity_bias_m_s=0.0, yaw_error_deg=0.0, height_error_m=0.0)
)
UP = TakeOffTo((NAN, NAN, -1.2))
SQUARE = [Waypoint((n, e, -1.2)) for n, e in ((1.5, 0.0), (1.5, 1.5), (0.0, 1.5), (0.0, 0.0))]


def load(flight, items):
    assert flight.autopilot.plans.problem(items) is None
    flight.autopilot.plans.mission.load(items)


def start(flight, items):
    load(flight, items)
    flight.get_ready()
    assert flight.autopilot.set_mode(FlightMode.MISSION) is Ack.ACCEPTED
    assert flight.autopilot.arm() is Ack.ACCEPTED


def follow(flight, limit_s=90.0):
    """Flies to the end of the mission; (item, time, true position) of each that was reached."""
    mission, log = flight.autopilot.plans.mission, []

    def done():
        while mission.reached:
            log.append((mission.reached.popleft(), flight.world.time_s, flight.world.truth))
        return mission.complete

    flight.wait_until(done, limit_s)
    done()
    return log


@pytest.fixture
def exact(make_flight):
    return make_flight(settings=EXACT)


def test_items_are_flown_in_order_and_within_the_acceptance_radius(exact):
    items = [UP, *SQUARE, LandAt((NAN, NAN, 0.0))]
    start(exact, items)
    log = follow(exact)
    assert [number for number, _, _ in log] == list(range(len(items)))
    for number, _, truth in log[1:5]:
        assert math.dist(truth.position_ned_m, items[number].position_ned_m) < 0.3 + 0.1
    exact.wait_until(lambda: not exact.status.armed, 5.0)
    assert exact.said("Mission finished")
    assert exact.world.crashed is None


def test_a_waypoint_on_the_ground_climbs_first(exact):
    start(exact, [SQUARE[0]])
    exact.wait_until(lambda: math.hypot(*exact.world.truth.position_ned_m[:2]) > 0.3, 10.0)
    assert -exact.world.truth.position_ned_m[2] > 0.9
    follow(exact)
    exact.run(3.0)
    assert exact.status.mode is FlightMode.HOLD
    assert exact.autopilot.estimate.position_ned_m == pytest.approx((1.5, 0.0, -1.2), abs=0.15)


def test_a_waypoint_is_held_and_a_delay_waited(exact):
    start(exact, [UP, Waypoint((1.0, 0.0, -1.2), hold_s=3.0), Delay(4.0), SQUARE[0]])
    times = {number: time_s for number, time_s, _ in follow(exact)}
    assert times[2] - times[1] == pytest.approx(4.0, abs=0.1)
    assert times[1] - times[0] > 3.0


def test_speed_and_heading_are_as_asked(exact):
    exact.take_off(1.2)
    far = Waypoint((6.0, 0.0, -1.2), yaw_rad=-1.0)
    load(exact, [ChangeSpeed(0.4), far])
    exact.autopilot.set_mode(FlightMode.MISSION)
    exact.run(5.0)
    assert math.hypot(*exact.world.truth.velocity_ned_m_s[:2]) == pytest.approx(0.4, abs=0.04)
    assert exact.world.truth.euler_rad[2] == pytest.approx(-1.0, abs=0.05)


def test_a_turn_is_relative_or_absolute(exact):
    exact.take_off(1.2)
    load(exact, [TurnTo(1.0), TurnTo(0.5, relative=True), Delay(2.0)])
    exact.autopilot.set_mode(FlightMode.MISSION)
    truths = [truth for _, _, truth in follow(exact)]
    assert truths[0].euler_rad[2] == pytest.approx(1.0, abs=0.25)
    assert truths[2].euler_rad[2] - truths[0].euler_rad[2] == pytest.approx(0.5, abs=0.25)


@pytest.mark.parametrize("repeats", [0, 1, 3])
def test_a_jump_is_taken_as_often_as_it_says(exact, repeats):
    exact.take_off(1.2)
    load(exact, [Delay(0.2), Delay(0.2), Jump(1, repeats), Delay(0.2)])
    exact.autopilot.set_mode(FlightMode.MISSION)
    reached = [number for number, _, _ in follow(exact)]
    assert reached == [0, *[1] * (1 + repeats), 3]


def test_a_return_hands_over_to_return_mode(exact):
    start(exact, [UP, SQUARE[0], ReturnToLaunch()])
    follow(exact)
    exact.run(0.2)
    assert exact.status.mode is FlightMode.RTL
    exact.wait_until(lambda: not exact.status.armed, 20.0)
    assert math.hypot(*exact.world.truth.position_ned_m[:2]) < 0.4


def test_a_mission_is_paused_and_goes_on_where_it_was(exact):
    start(exact, [UP, *SQUARE])
    mission = exact.autopilot.plans.mission
    exact.wait_until(lambda: mission.current == 2, 20.0)
    exact.autopilot.set_mode(FlightMode.HOLD)
    exact.run(2.0)
    assert exact.status.mission[::2] == (2, MissionState.PAUSED)
    exact.autopilot.set_mode(FlightMode.MISSION)
    exact.run(0.1)
    assert exact.status.mission[::2] == (2, MissionState.ACTIVE)
    assert mission.select(4)
    follow(exact)
    assert math.hypot(*exact.world.truth.position_ned_m[:2]) < 0.4


def test_a_finished_mission_starts_again_from_its_first_item(exact):
    exact.take_off(1.2)
    load(exact, [Delay(0.1), Delay(0.1)])
    for _ in range(2):
        exact.autopilot.set_mode(FlightMode.MISSION)
        assert [number for number, _, _ in follow(exact)] == [0, 1]
        exact.run(0.1)
        assert exact.status.mode is FlightMode.HOLD


def test_a_mission_cleared_in_flight_ends_in_hold(exact):
    start(exact, [UP, *SQUARE])
    exact.run(8.0)
    exact.autopilot.plans.mission.load(())
    exact.run(0.1)
    assert exact.status.mode is FlightMode.HOLD
    assert exact.autopilot.set_mode(FlightMode.MISSION) is Ack.TEMPORARILY_REJECTED


@pytest.mark.parametrize(
    ("items", "number", "text"),
    [
        ([UP, Jump(5, 1)], 1, "no item to jump to: 5"),
        ([UP, Jump(1, 1)], 1, "no item to jump to: 1"),
        ([UP, Waypoint((1.0, 0.0, 0.5))], 1, "below home"),
        ([UP, Waypoint((20_000.0, 0.0, -2.0))], 1, "first place is 20000 m away"),
        ([UP, SQUARE[0], Waypoint((4.0, 0.0, -1.0))], 2, "outside the geofence"),
    ],
)
def test_what_cannot_be_flown_is_named(flight, items, number, text):
    flight.autopilot.plans.fence = (Circle((0.0, 0.0), 3.0, True),)
    if "away" in text:
        flight.autopilot.plans.fence = ()
    assert flight.autopilot.plans.problem(items) == (number, text)


def test_a_fence_that_comes_later_keeps_the_mission_on_the_ground(flight):
    load(flight, [UP, SQUARE[0]])
    flight.autopilot.plans.fence = (Circle((0.0, 0.0), 1.0, True),)
    assert flight.autopilot.set_mode(FlightMode.MISSION) is Ack.TEMPORARILY_REJECTED
    assert flight.said("Mission item 1: outside the geofence")


numbers = st.integers(0, 7)
simple = st.one_of(
    st.just(Delay(1.0)), st.builds(Jump, numbers, st.integers(0, 3)), st.just(ChangeSpeed(1.0))
)


@given(st.lists(simple, min_size=1, max_size=8))
def test_every_sound_plan_of_finite_jumps_ends(plans_items):
    """And between two jumps items follow each other."""
    targets_sound = all(
        item.target < len(plans_items) and not isinstance(plans_items[item.target], Jump)
        for item in plans_items
        if isinstance(item, Jump)
    )
    if not targets_sound:
        return
    mission = Mission()
    mission.load(plans_items)
    for _ in range(10_000):
        if mission.complete:
            break
        assert not isinstance(mission.item, Jump)
        mission.finish_item()
    assert mission.complete


SQUARE_FENCE = ((-2.0, -1.0), (-2.0, 1.0), (2.0, 1.0), (2.0, -1.0))
coordinates = st.floats(-4.0, 4.0).filter(lambda value: abs(abs(value) - 1.5) > 0.6)


@given(coordinates, st.floats(-4.0, 4.0).filter(lambda e: abs(abs(e) - 1.0) > 1e-6))
def test_a_polygon_contains_what_lies_within(north_m, east_m):
    polygon = Polygon(SQUARE_FENCE, True)
    assert polygon.contains((north_m, east_m)) == (abs(north_m) < 2.0 and abs(east_m) < 1.0)


def test_areas_are_combined_as_px4_does():
    wide, narrow = Circle((0.0, 0.0), 3.0, True), Circle((6.0, 0.0), 1.0, True)
    hole = Polygon(((-1.0, -1.0), (-1.0, 1.0), (1.0, 0.0)), False)
    assert allowed((), (99.0, 0.0))
    assert allowed((wide, narrow, hole), (6.0, 0.5))
    assert allowed((wide, narrow, hole), (2.0, 0.0))
    assert not allowed((wide, narrow, hole), (4.5, 0.0))
    assert not allowed((wide, narrow, hole), (0.0, 0.0))
    assert allowed((hole,), (99.0, 0.0))
