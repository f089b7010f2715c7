"""What the autopilot does by itself, and when: all times are simulated."""

import math

import pytest

from companion.kernel.messages import FlightMode, LandedState
from sitl.autopilot.interface import Ack
from sitl.settings import BatterySettings, SitlSettings


def test_offboard_needs_setpoints_to_arm_and_to_be_entered(flight):
    flight.get_ready()
    assert flight.autopilot.set_mode(FlightMode.OFFBOARD) is Ack.ACCEPTED
    assert flight.autopilot.arm() is Ack.TEMPORARILY_REJECTED
    flight.autopilot.set_mode(FlightMode.HOLD)
    flight.take_off()
    assert flight.autopilot.set_mode(FlightMode.OFFBOARD) is Ack.TEMPORARILY_REJECTED
    assert flight.status.mode is FlightMode.HOLD
    flight.send()
    assert flight.autopilot.set_mode(FlightMode.OFFBOARD) is Ack.ACCEPTED
    assert flight.status.mode is FlightMode.OFFBOARD


@pytest.mark.parametrize(
    ("action", "mode"),
    [(0, FlightMode.RTL), (3, FlightMode.RTL), (4, FlightMode.LAND), (5, FlightMode.HOLD)],
)
def test_lost_setpoints_trip_the_failsafe_after_one_second(airborne, action, mode):
    airborne.autopilot.set_parameter("COM_OBL_RC_ACT", action)
    airborne.fly(2.0, north_m_s=0.5)
    airborne.send(north_m_s=0.5)
    last_s = airborne.world.time_s
    tripped_s = airborne.wait_until(lambda: airborne.status.failsafe, 2.0)
    assert 1.0 <= tripped_s - last_s <= 1.07
    assert airborne.status.mode is mode
    assert airborne.said("Failsafe activated") == [pytest.approx(tripped_s, abs=0.03)]
    airborne.run(1.5)
    assert airborne.world.truth.velocity_ned_m_s[0] < 0.1


def test_the_time_until_then_is_a_parameter(airborne):
    airborne.autopilot.set_parameter("COM_OF_LOSS_T", 0.4)
    airborne.fly(1.0)
    airborne.send()
    last_s = airborne.world.time_s
    assert airborne.wait_until(lambda: airborne.status.failsafe, 1.0) - last_s < 0.47


def test_offboard_resumes_within_a_fifth_of_a_second_when_setpoints_return(airborne):
    airborne.fly(1.0)
    airborne.wait_until(lambda: airborne.status.failsafe, 2.0)
    airborne.run(0.3)
    airborne.send()
    back_s = airborne.world.time_s
    resumed_s = airborne.wait_until(lambda: airborne.status.mode is FlightMode.OFFBOARD, 0.3)
    assert resumed_s - back_s < 0.2
    assert not airborne.status.failsafe


@pytest.mark.parametrize(("period_s", "holds"), [(0.66, True), (1.25, False)])
def test_a_slow_stream_is_enough_until_it_is_slower_than_the_limit(airborne, period_s, holds):
    airborne.fly(1.0)
    for _ in range(6):
        airborne.send()
        airborne.world.advance_to(airborne.world.time_s + period_s)
    assert bool(airborne.said("Failsafe activated")) is not holds


def test_a_commanded_mode_ends_the_offboard_failsafe(airborne):
    airborne.fly(1.0)
    airborne.wait_until(lambda: airborne.status.failsafe, 2.0)
    airborne.autopilot.set_mode(FlightMode.HOLD)
    airborne.run(0.1)
    assert not airborne.status.failsafe
    assert airborne.status.mode is FlightMode.HOLD


def test_a_lost_companion_ends_at_home_on_the_ground_disarmed(airborne):
    airborne.fly(4.0, north_m_s=0.5)
    airborne.wait_until(lambda: not airborne.status.armed, 25.0)
    assert math.hypot(*airborne.world.truth.position_ned_m[:2]) < 0.5
    assert airborne.said("Disarmed by landing")
    assert airborne.world.crashed is None


def test_low_battery_warns_and_critical_battery_lands(make_flight):
    # A twentieth of the real pack: minutes become seconds.
    settings = SitlSettings(battery=BatterySettings(capacity_mah=75.0, charge_norm=0.6))
    flight = make_flight(settings=settings)
    flight.take_off()
    flight.wait_until(lambda: flight.status.battery_norm <= 0.15, 60.0)
    flight.run(0.2)
    assert flight.said("Low battery level")
    assert flight.status.mode is FlightMode.HOLD
    flight.wait_until(lambda: flight.status.battery_norm <= 0.07, 60.0)
    flight.run(0.2)
    assert flight.said("Critical battery level")
    assert flight.said("Failsafe activated, entering Hold for 5 seconds")
    assert flight.status.mode is FlightMode.HOLD
    flight.run(5.0)
    assert flight.status.mode is FlightMode.LAND
    flight.wait_until(lambda: not flight.status.armed, 12.0)
    assert flight.autopilot.arm() is Ack.TEMPORARILY_REJECTED


def test_the_battery_lasts_as_long_as_the_pack_is_known_to(airborne):
    before = airborne.status.battery_norm
    airborne.run(10.0)
    minutes = 10.0 / 60.0 / (before - airborne.status.battery_norm)
    assert 14.0 < minutes < 18.0
    assert 9.6 < airborne.status.battery_voltage_v < 12.6


@pytest.mark.parametrize(
    ("action", "mode"),
    [(1, FlightMode.OFFBOARD), (2, FlightMode.HOLD), (3, FlightMode.RTL), (5, FlightMode.LAND)],
)
def test_the_fence_acts_as_its_parameter_says(airborne, action, mode):
    airborne.autopilot.set_parameter("GF_MAX_HOR_DIST", 1.0)
    airborne.autopilot.set_parameter("GF_ACTION", action)
    airborne.autopilot.set_parameter("COM_FAIL_ACT_T", 0.0)
    airborne.fly(4.0, north_m_s=0.5)
    assert airborne.said("Geofence exceeded")
    assert airborne.status.mode is mode
    if mode is FlightMode.HOLD:
        assert airborne.world.truth.position_ned_m[0] < 1.0 + 0.45


def test_a_commanded_mode_takes_the_vehicle_back_from_the_fence(airborne):
    airborne.autopilot.set_parameter("GF_MAX_HOR_DIST", 1.0)
    airborne.fly(4.0, north_m_s=0.5)
    assert airborne.status.mode is FlightMode.HOLD
    airborne.fly(3.0, north_m_s=-0.5)
    assert airborne.world.truth.position_ned_m[0] < 0.5
    airborne.fly(4.0, north_m_s=0.5)
    assert airborne.status.mode is FlightMode.HOLD


def test_the_fence_has_a_lid(airborne):
    airborne.autopilot.set_parameter("GF_MAX_VER_DIST", 2.0)
    airborne.fly(3.0, down_m_s=-0.5)
    assert airborne.status.failsafe


def test_a_vehicle_that_tumbles_is_switched_off(airborne):
    airborne.world.airframe.set_motor_efficiency(0, 0.0)
    airborne.wait_until(lambda: not airborne.status.armed, 3.0)
    assert airborne.said("Flight terminated: Attitude failure detected")
    airborne.run(2.0)
    assert airborne.world.crashed is not None


def test_failsafes_are_silent_on_the_ground(flight):
    flight.get_ready()
    flight.autopilot.arm()
    flight.send()
    flight.autopilot.set_mode(FlightMode.OFFBOARD)
    flight.run(3.0)
    assert flight.status.landed_state is LandedState.ON_GROUND
    assert not flight.said("Failsafe activated")
