"""The estimator loses the place: what PX4's parameters make of it, and when; simulated times."""

import math

import pytest

from companion.kernel.frames import quaternion_from_euler
from companion.kernel.messages import FlightMode
from sitl.autopilot.estimation.vision_sample import VisionSample
from sitl.autopilot.interface import Ack, AttitudeSetpoint, ManualInput
from sitl.failures import Kind, Unit

LOST = "No valid position estimate"
STEP_S = 0.04
"""Two steps of the autopilot."""
CENTRED = ManualInput(0.0, 0.0, 0.0, 0.0)


def lose(flight, kind=Kind.OFF):
    assert flight.autopilot.failures.inject(Unit.OPTICAL_FLOW, kind)
    return flight.world.time_s


def wait_for_failsafe(flight, each=lambda: None, limit_s=10.0):
    """How long from now until the failsafe reacts."""
    began_s = flight.world.time_s
    while not flight.status.failsafe:
        assert flight.world.time_s < began_s + limit_s
        each()
        flight.world.advance_to(flight.world.time_s + 0.02)
    return flight.world.time_s - began_s


@pytest.mark.parametrize("kind", [Kind.OFF, Kind.STUCK, Kind.GARBAGE])
@pytest.mark.parametrize("patience_s", [1.0, 5.0])
def test_without_aiding_it_descends_after_noaid_tout(airborne, kind, patience_s, px4_row):
    airborne.autopilot.set_parameter("EKF2_NOAID_TOUT", patience_s * 1e6)
    place = airborne.world.truth.position_ned_m
    lose(airborne, kind)
    took_s = wait_for_failsafe(airborne)
    px4_row(
        "Failsafes",
        f"No aiding: flow {kind.name.lower()}",
        f"EKF2_NOAID_TOUT = {patience_s * 1e6:g}",
        f"{patience_s:g} s",
        f"{took_s:.2f} s",
        "land (a level descent)",
    )
    assert patience_s <= took_s <= patience_s + STEP_S
    assert airborne.status.mode is FlightMode.LAND
    assert airborne.said(LOST)
    assert airborne.said("Failsafe activated")
    assert not airborne.autopilot.quality.level_valid
    airborne.wait_until(lambda: not airborne.status.armed, 10.0)
    assert airborne.world.crashed is None
    assert math.dist(airborne.world.truth.position_ned_m[:2], place[:2]) < 5.0


def test_it_goes_back_to_the_mode_when_the_place_is_known_again(airborne):
    airborne.autopilot.set_parameter("EKF2_NOAID_TOUT", 500_000)
    lose(airborne)
    wait_for_failsafe(airborne)
    airborne.autopilot.failures.inject(Unit.OPTICAL_FLOW, Kind.OK)
    airborne.run(5.0)
    assert airborne.status.mode is FlightMode.HOLD
    assert not airborne.status.failsafe
    speed_m_s = math.hypot(*airborne.world.truth.velocity_ned_m_s)
    assert speed_m_s < 0.1


def test_with_vision_nothing_happens(airborne):
    place = airborne.world.truth.position_ned_m

    def see():
        truth, home_m = airborne.world.truth, airborne.world.room_from_home_m
        seen_m = tuple(a - b for a, b in zip(truth.position_ned_m, home_m, strict=True))
        airborne.autopilot.take_vision(
            VisionSample(airborne.world.time_s, seen_m, quaternion_from_euler(*truth.euler_rad))
        )

    airborne.run(1.0, see)
    lose(airborne)
    airborne.run(15.0, see)
    assert airborne.status.mode is FlightMode.HOLD
    assert math.dist(airborne.world.truth.position_ned_m, place) < 0.6
    airborne.autopilot.failures.inject(Unit.VISION, Kind.OFF)
    assert wait_for_failsafe(airborne, see) == pytest.approx(5.0, abs=0.15)


def test_satellites_hold_the_place_where_flow_does_not(airborne):
    autopilot, place = airborne.autopilot, airborne.world.truth.position_ned_m
    autopilot.set_parameter("SYS_HAS_GPS", 1)
    lose(airborne)
    airborne.run(20.0)
    assert airborne.status.mode is FlightMode.HOLD
    assert autopilot.quality.absolute
    assert math.dist(airborne.world.truth.position_ned_m[:2], place[:2]) < 1.0
    autopilot.failures.inject(Unit.GPS, Kind.STUCK)
    assert wait_for_failsafe(airborne) == pytest.approx(5.0, abs=0.25)


@pytest.mark.parametrize(
    ("action", "mode"), [(0, FlightMode.ALTITUDE), (1, FlightMode.LAND)], ids=["altitude", "land"]
)
def test_by_hand_com_posctl_navl_chooses(airborne, action, mode):
    airborne.autopilot.set_parameter("COM_POSCTL_NAVL", action)
    airborne.autopilot.set_manual_input(CENTRED)
    assert airborne.autopilot.set_mode(FlightMode.POSITION) is Ack.ACCEPTED
    lose(airborne)
    wait_for_failsafe(airborne, lambda: airborne.autopilot.set_manual_input(CENTRED))
    assert airborne.status.mode is mode


def test_in_altitude_mode_sticks_tilt_and_the_height_stays(airborne):
    autopilot = airborne.autopilot
    autopilot.set_manual_input(CENTRED)
    assert autopilot.set_mode(FlightMode.ALTITUDE) is Ack.ACCEPTED
    height_m = -airborne.world.truth.position_ned_m[2]
    tilted = ManualInput(0.55, 0.0, 0.0, 0.0)  # half of what lies beyond the dead zone
    airborne.run(1.0, lambda: autopilot.set_manual_input(tilted))
    pitch_rad = airborne.world.truth.euler_rad[1]
    assert math.degrees(pitch_rad) == pytest.approx(-7.6, abs=1.0)
    airborne.run(2.0, lambda: autopilot.set_manual_input(CENTRED))
    assert airborne.world.truth.euler_rad[1] == pytest.approx(0.0, abs=0.03)
    assert airborne.world.truth.velocity_ned_m_s[0] > 0.2
    assert -airborne.world.truth.position_ned_m[2] == pytest.approx(height_m, abs=0.1)


def test_offboard_attitude_needs_no_place(airborne):
    hover = AttitudeSetpoint(0.0, 0.0, 0.0, (math.nan,) * 3, airborne.status.thrust_norm)
    airborne.autopilot.set_offboard_setpoint(hover)
    airborne.autopilot.set_mode(FlightMode.OFFBOARD)
    lose(airborne)
    airborne.run(7.0, lambda: airborne.autopilot.set_offboard_setpoint(hover))
    assert airborne.status.mode is FlightMode.OFFBOARD
    assert not airborne.status.failsafe


@pytest.mark.parametrize("mode", [FlightMode.HOLD, FlightMode.RTL, FlightMode.OFFBOARD])
def test_modes_that_need_a_place_are_refused(airborne, mode):
    airborne.autopilot.set_parameter("EKF2_NOAID_TOUT", 500_000)
    lose(airborne)
    wait_for_failsafe(airborne)
    airborne.send()
    assert airborne.autopilot.set_mode(mode) is Ack.TEMPORARILY_REJECTED
    assert airborne.autopilot.set_mode(FlightMode.LAND) is Ack.ACCEPTED
    airborne.wait_until(lambda: not airborne.status.armed, 10.0)


def test_an_empty_battery_cannot_bring_it_home(airborne):
    airborne.autopilot.set_parameter("EKF2_NOAID_TOUT", 500_000)
    airborne.autopilot.set_parameter("COM_LOW_BAT_ACT", 1)
    lose(airborne)
    wait_for_failsafe(airborne)
    airborne.autopilot.set_charge(0.05)
    airborne.run(1.0)
    assert airborne.status.mode is FlightMode.LAND


def test_arming_needs_the_place(flight):
    flight.get_ready()
    lose(flight)
    flight.run(6.0)
    assert flight.autopilot.arm() is Ack.TEMPORARILY_REJECTED
    assert flight.said("Arming denied: no valid local position estimate")


def test_without_range_finder_and_barometer_the_height_is_not_valid(airborne):
    truth = airborne.world.truth
    for unit in (Unit.RANGE_FINDER, Unit.BAROMETER):
        airborne.autopilot.failures.inject(unit, Kind.OFF)
    airborne.run(4.0)
    assert airborne.autopilot.quality.height_valid
    airborne.run(2.0)
    assert not airborne.autopilot.quality.height_valid
    fallen_m = airborne.world.truth.position_ned_m[2] - truth.position_ned_m[2]
    assert 0.1 < abs(fallen_m) < 1.0


def test_the_barometer_stands_in_for_the_range_finder(airborne):
    before_m = airborne.world.truth.position_ned_m[2]
    airborne.autopilot.failures.inject(Unit.RANGE_FINDER, Kind.OFF)
    first = len(airborne.states)
    airborne.run(20.0)
    assert airborne.autopilot.quality.height_valid
    wandered_m = max(abs(s.position_ned_m[2] - before_m) for s in airborne.states[first:])
    assert 0.05 < wandered_m < 0.6
    assert airborne.autopilot.quality.height_deviation_m == pytest.approx(0.15, abs=0.01)
