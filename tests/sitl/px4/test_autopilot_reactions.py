"""Every failsafe: what it does, and how long after its cause; all times are simulated."""

import math
from typing import NamedTuple

import pytest

from companion.kernel.messages import FlightMode
from sitl.autopilot.geofence import Polygon
from sitl.autopilot.interface import Ack, ManualInput
from sitl.settings import BatterySettings, SitlSettings

CENTRED = ManualInput(0.0, 0.0, 0.0, 0.0)
HOLD, RTL, LAND, POSITION = FlightMode.HOLD, FlightMode.RTL, FlightMode.LAND, FlightMode.POSITION
NOW = 0.05
"""Two steps of the autopilot and a bit."""


def no_setpoints(flight):
    flight.send()
    flight.autopilot.set_mode(FlightMode.OFFBOARD)
    flight.send()


def no_setpoints_but_sticks(flight):
    no_setpoints(flight)
    flight.each = lambda: flight.autopilot.set_manual_input(CENTRED)
    flight.each()


def no_sticks(flight):
    flight.autopilot.set_manual_input(CENTRED)
    flight.autopilot.set_mode(FlightMode.POSITION)
    flight.run(0.2, lambda: flight.autopilot.set_manual_input(CENTRED))


def no_ground_station(flight):
    flight.autopilot.hear_ground_station()


def fence_around_elsewhere(flight):
    corners = ((5.0, 5.0), (5.0, 6.0), (6.0, 6.0))
    flight.autopilot.plans.fence = (Polygon(corners, True),)


def too_high(flight):
    flight.autopilot.set_parameter("GF_MAX_VER_DIST", 1.0)


def battery_at(threshold):
    return lambda flight: flight.autopilot.set_parameter(threshold, 0.5)


class Row(NamedTuple):
    """A cause, the parameter that chooses, the mode at first and the one in the end."""

    cause: object
    parameter: str
    value: int
    trips_s: float
    first: FlightMode
    then: FlightMode
    says: str


OFFBOARD, STICKS, LINK = "No offboard setpoints", "Manual control lost", "Ground station lost"
FENCE, CRITICAL, EMERGENCY = (
    "Geofence exceeded",
    "Critical battery level",
    "Dangerous battery level",
)
TABLE = [
    Row(no_setpoints, "COM_OBL_RC_ACT", 0, 1.0, RTL, RTL, OFFBOARD),
    Row(no_setpoints_but_sticks, "COM_OBL_RC_ACT", 0, 1.0, POSITION, POSITION, OFFBOARD),
    Row(no_setpoints, "COM_OBL_RC_ACT", 3, 1.0, RTL, RTL, OFFBOARD),
    Row(no_setpoints, "COM_OBL_RC_ACT", 4, 1.0, LAND, LAND, OFFBOARD),
    Row(no_setpoints, "COM_OBL_RC_ACT", 5, 1.0, HOLD, HOLD, OFFBOARD),
    Row(no_sticks, "NAV_RCL_ACT", 1, 0.5, HOLD, HOLD, STICKS),
    Row(no_sticks, "NAV_RCL_ACT", 2, 0.5, HOLD, RTL, STICKS),
    Row(no_sticks, "NAV_RCL_ACT", 3, 0.5, HOLD, LAND, STICKS),
    Row(no_ground_station, "NAV_DLL_ACT", 1, 10.0, HOLD, HOLD, LINK),
    Row(no_ground_station, "NAV_DLL_ACT", 2, 10.0, HOLD, RTL, LINK),
    Row(no_ground_station, "NAV_DLL_ACT", 3, 10.0, HOLD, LAND, LINK),
    Row(fence_around_elsewhere, "GF_ACTION", 2, 0.0, HOLD, HOLD, FENCE),
    Row(fence_around_elsewhere, "GF_ACTION", 3, 0.0, HOLD, RTL, FENCE),
    Row(too_high, "GF_ACTION", 5, 0.0, HOLD, LAND, FENCE),
    Row(battery_at("BAT_CRIT_THR"), "COM_LOW_BAT_ACT", 1, 0.0, HOLD, RTL, CRITICAL),
    Row(battery_at("BAT_CRIT_THR"), "COM_LOW_BAT_ACT", 2, 0.0, HOLD, LAND, CRITICAL),
    Row(battery_at("BAT_CRIT_THR"), "COM_LOW_BAT_ACT", 3, 0.0, HOLD, RTL, CRITICAL),
    Row(battery_at("BAT_EMERGEN_THR"), "COM_LOW_BAT_ACT", 3, 0.0, HOLD, LAND, EMERGENCY),
]


@pytest.fixture
def weak(make_flight):
    """In the air on a battery that is low but not critical."""
    flight = make_flight(settings=SitlSettings(battery=BatterySettings(charge_norm=0.4)))
    flight.each = lambda: None
    flight.take_off()
    return flight


@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row.parameter}={row.value}-{row.says}")
def test_cause_and_reaction(weak, row, px4_row):
    assert weak.autopilot.set_parameter(row.parameter, row.value)
    row.cause(weak)
    began_s = weak.world.time_s
    if row.cause is no_sticks:
        began_s -= 0.1  # the last of the ten per second
    while not weak.status.failsafe:
        assert weak.world.time_s < began_s + 12.0
        weak.each()
        weak.world.advance_to(weak.world.time_s + 0.02)
    took_s = weak.world.time_s - began_s
    px4_row(
        "Failsafes",
        row.says,
        f"{row.parameter} = {row.value}",
        f"{row.trips_s:g} s",
        f"{took_s:.2f} s",
        row.first if row.first is row.then else f"{row.first}, then {row.then}",
    )
    assert 0.0 <= took_s - row.trips_s <= NOW
    assert weak.status.mode is row.first
    delayed = row.first is HOLD and (row.then is not HOLD or row.parameter != "GF_ACTION")
    delayed = delayed and row.parameter != "COM_OBL_RC_ACT"
    words = "Failsafe activated" + (", entering Hold for 5 seconds" if delayed else "")
    assert weak.said(words)
    assert weak.said(row.says)
    weak.run(4.8, weak.each)
    assert weak.status.mode is row.first
    weak.run(0.4, weak.each)
    assert weak.status.mode is row.then
    assert weak.status.failsafe


@pytest.mark.parametrize(
    ("parameter", "value", "cause"),
    [
        ("COM_OBL_RC_ACT", 6, no_setpoints),
        ("NAV_RCL_ACT", 5, no_sticks),
        ("GF_ACTION", 4, fence_around_elsewhere),
    ],
)
def test_termination_switches_the_motors_off_at_once(weak, parameter, value, cause, px4_row):
    weak.autopilot.set_parameter(parameter, value)
    cause(weak)
    began_s = weak.world.time_s
    took_s = weak.wait_until(lambda: not weak.status.armed, 1.1) - began_s
    what = cause.__name__.replace("_", " ").capitalize()
    px4_row("Failsafes", what, f"{parameter} = {value}", "", f"{took_s:.2f} s", "motors off")


def test_a_pilot_takes_over_during_the_delay_and_keeps_the_vehicle(weak):
    battery_at("BAT_CRIT_THR")(weak)
    weak.run(2.0)
    weak.autopilot.set_manual_input(CENTRED)
    assert weak.autopilot.set_mode(FlightMode.POSITION) is Ack.ACCEPTED
    weak.run(6.0, lambda: weak.autopilot.set_manual_input(CENTRED))
    assert weak.status.mode is FlightMode.POSITION
    battery_at("BAT_EMERGEN_THR")(weak)  # something new
    weak.run(4.7, lambda: weak.autopilot.set_manual_input(CENTRED))
    assert weak.status.mode is FlightMode.LAND


def test_the_worst_of_two_reactions_wins_without_another_delay(weak):
    weak.autopilot.set_parameter("NAV_DLL_ACT", 2)
    no_ground_station(weak)
    weak.run(16.0)
    assert weak.status.mode is FlightMode.RTL
    fence_around_elsewhere(weak)
    weak.autopilot.set_parameter("GF_ACTION", 5)
    weak.run(0.1)
    assert weak.status.mode is FlightMode.LAND


def test_a_lost_link_that_comes_back_leaves_the_vehicle_returning(weak):
    weak.autopilot.set_parameter("NAV_DLL_ACT", 2)
    no_ground_station(weak)
    weak.run(15.5)
    assert weak.status.mode is FlightMode.RTL
    weak.run(0.5, weak.autopilot.hear_ground_station)
    assert weak.status.mode is FlightMode.RTL
    weak.autopilot.set_mode(FlightMode.HOLD)
    weak.run(0.5, weak.autopilot.hear_ground_station)
    assert weak.status.mode is FlightMode.HOLD
    assert not weak.status.failsafe


def test_a_link_that_flickers_does_not_restart_the_full_delay(weak):
    weak.autopilot.set_parameter("GF_ACTION", 2)
    battery_at("BAT_CRIT_THR")(weak)
    weak.run(4.0)
    weak.autopilot.set_parameter("BAT_CRIT_THR", 0.07)
    weak.run(0.4)
    assert not weak.status.failsafe
    battery_at("BAT_CRIT_THR")(weak)
    weak.run(1.5)
    assert weak.status.mode is FlightMode.LAND


def test_sticks_that_were_never_there_are_not_missed(weak):
    weak.run(5.0)
    assert not weak.status.failsafe


def test_modes_can_be_excepted_from_the_loss_of_sticks(weak):
    weak.autopilot.set_parameter("COM_RCL_EXCEPT", 2)
    weak.autopilot.set_manual_input(CENTRED)
    weak.run(5.0)
    assert weak.status.mode is FlightMode.HOLD
    assert not weak.status.failsafe


def test_a_needed_ground_station_is_asked_for_before_arming(flight):
    flight.get_ready()
    flight.autopilot.set_parameter("NAV_DLL_ACT", 2)
    assert flight.autopilot.arm() is Ack.TEMPORARILY_REJECTED
    assert flight.said("Arming denied: no ground station")
    flight.autopilot.hear_ground_station()
    assert flight.autopilot.arm() is Ack.ACCEPTED


def test_the_tilt_limit_strikes_after_its_time(weak, px4_row):
    weak.autopilot.set_parameter("FD_FAIL_R", 10)
    weak.autopilot.set_parameter("FD_FAIL_R_TTRI", 0.3)
    weak.autopilot.set_parameter("MPC_ACC_HOR", 15.0)
    weak.autopilot.set_parameter("MPC_JERK_AUTO", 80.0)
    weak.send(east_m_s=2.0)
    weak.autopilot.set_mode(FlightMode.OFFBOARD)
    tilted_s = weak.wait_until(lambda: weak.world.truth.euler_rad[0] > math.radians(10.0), 1.0)
    ended_s = weak.wait_until(lambda: not weak.status.armed, 1.0)
    took_s = ended_s - tilted_s
    px4_row("Failsafes", "Tilted", "CBRK_FLIGHTTERM = 0", "0.3 s", f"{took_s:.2f} s", "motors off")
    assert 0.25 < took_s < 0.4
    assert weak.said("Flight terminated: Attitude failure detected")
