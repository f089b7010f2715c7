"""What breaks: battery, motors, sticks and cameras, by a plan, a command or a fault."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.errors import PlanError
from companion.kernel.messages import FlightMode
from companion.kernel.settings import convert_settings
from sitl.autopilot.interface import Ack, ManualInput
from sitl.build import build
from sitl.failures import Kind, Unit
from sitl.faults import Faults
from sitl.injection import inject
from sitl.settings import BatterySettings, SitlSettings

MOTOR, BATTERY = Unit.MOTOR, Unit.BATTERY
COMMAND = mavlink.MAV_CMD_INJECT_FAILURE


def test_the_voltage_sags_with_the_current(airborne):
    """Ohm's law: what BAT1_R_INTERNAL grows by, times the current, is what is missing."""
    before = airborne.status
    airborne.autopilot.set_parameter("BAT1_R_INTERNAL", 0.16)
    airborne.run(0.1)
    after = airborne.status
    assert after.battery_current_a == pytest.approx(5.4, abs=0.8)
    sag_v = before.battery_voltage_v - after.battery_voltage_v
    assert sag_v == pytest.approx(0.1 * after.battery_current_a, abs=0.02)


def test_a_sagging_battery_takes_thrust_away_if_it_is_asked_to(make_flight):
    def climb_m(limits_thrust):
        battery = BatterySettings(limits_thrust=limits_thrust, charge_norm=0.3)
        flight = make_flight(settings=SitlSettings(battery=battery))
        flight.autopilot.set_parameter("BAT1_R_INTERNAL", 0.2)
        for name, value in (("MPC_Z_VEL_MAX_UP", 8.0), ("MPC_ACC_UP_MAX", 15.0)):
            flight.autopilot.set_parameter(name, value)
        flight.take_off()
        before_m = flight.world.truth.position_ned_m[2]
        flight.fly(1.5, down_m_s=-8.0)
        return before_m - flight.world.truth.position_ned_m[2]

    assert climb_m(True) < 0.85 * climb_m(False)


def test_a_failing_battery_is_empty_until_it_is_mended(fly_mavlink):
    flight = fly_mavlink()
    flight.autopilot.set_parameter("SYS_FAILURE_EN", 1)
    assert flight.acks(COMMAND, BATTERY, Kind.OFF, 0.0) == [Ack.ACCEPTED]
    assert flight.autopilot.status.battery_norm == 0.0
    assert flight.acks(COMMAND, BATTERY, Kind.OK, 0.0) == [Ack.ACCEPTED]
    assert flight.autopilot.status.battery_norm > 0.99


@pytest.mark.parametrize("way", ["plan", "command", "fault"])
def test_a_weak_motor_is_held_by_control(make_flight, way):
    """Front right at 75 %: it tips there, turns against the rotor it still has, and stays."""
    weak = (0.75, 1.0, 1.0, 1.0)
    events = [{"at_s": 20.0, "motor_efficiency_norm": weak}] if way == "plan" else []
    flight = make_flight(settings=convert_settings({"events": events}, SitlSettings, "sitl"))
    flight.take_off()
    flight.world.advance_to(20.0)
    if way == "fault":
        inject(flight.world, Faults(motor_efficiency_norm=weak))
    elif way == "command":
        flight.autopilot.set_parameter("SYS_FAILURE_EN", 1)
        assert flight.autopilot.inject_failure(MOTOR, Kind.SLOW, 1) is Ack.ACCEPTED
    before, first = flight.world.truth, len(flight.states)
    flight.run(1.0)
    jolt = np.array([state.rates_frd_rad_s for state in flight.states[first:]])
    assert np.max(jolt[:, 0]) > 0.1  # rolls to the right
    assert np.min(jolt[:, 1]) < -0.1  # pitches forward
    flight.run(6.0)
    after = flight.world.truth
    commanded = np.array(after.motors_norm) / weak
    assert commanded[0] > 1.2 * commanded[2]
    assert after.euler_rad[:2] == pytest.approx((0.0, 0.0), abs=0.05)
    assert 0.03 < before.euler_rad[2] - after.euler_rad[2] < 0.25
    assert math.dist(after.position_ned_m, before.position_ned_m) < 0.5
    assert flight.status.mode is FlightMode.HOLD


def test_without_a_motor_it_tumbles_and_the_failure_detector_ends_it(airborne):
    airborne.autopilot.set_parameter("SYS_FAILURE_EN", 1)
    assert airborne.autopilot.inject_failure(MOTOR, Kind.OFF, 1) is Ack.ACCEPTED
    airborne.wait_until(lambda: not airborne.status.armed, 3.0)
    assert airborne.said("Attitude failure detected")


def test_failures_are_denied_unless_they_are_enabled(fly_mavlink):
    flight = fly_mavlink()
    gps_off = (Unit.GPS, Kind.OFF, 0.0)
    assert flight.acks(COMMAND, *gps_off) == [Ack.DENIED]
    flight.autopilot.set_parameter("SYS_FAILURE_EN", 1)
    assert flight.acks(COMMAND, *gps_off) == [Ack.ACCEPTED]
    assert flight.autopilot.failures.of(Unit.GPS) is Kind.OFF
    for unit, kind in ((Unit.GYRO, Kind.OFF), (Unit.SERVO, Kind.OFF), (Unit.GPS, Kind.SLOW)):
        assert flight.acks(COMMAND, unit, kind, 0.0) == [Ack.UNSUPPORTED]
    for nonsense in ((math.nan, 1.0, 0.0), (4.0, math.nan, 0.0), (1e9, 1.0, 0.0), (101, 1, 9.0)):
        assert flight.acks(COMMAND, *nonsense) == [Ack.UNSUPPORTED]


def test_sticks_that_fail_are_lost(airborne):
    centred = ManualInput(0.0, 0.0, 0.0, 0.0)
    autopilot = airborne.autopilot
    autopilot.set_manual_input(centred)
    autopilot.set_mode(FlightMode.POSITION)
    airborne.run(1.0, lambda: autopilot.set_manual_input(centred))
    autopilot.failures.inject(Unit.STICKS, Kind.OFF)
    airborne.run(1.0, lambda: autopilot.set_manual_input(centred))
    assert airborne.said("Manual control lost")


def test_a_plan_sets_parameters_and_lets_things_fail_in_time(make_flight):
    table = {
        "parameters": {"MIS_TAKEOFF_ALT": 1.25},
        "faults": {"failures": {"magnetometer": "off"}},
        "events": [
            {"at_s": 2.0, "failures": {"optical_flow": "stuck"}},
            {"at_s": 1.0, "parameters": {"EKF2_NOAID_TOUT": 1e6}, "charge_norm": 0.5},
        ],
    }
    flight = make_flight(settings=convert_settings(table, SitlSettings, "sitl"))
    failures = flight.autopilot.failures
    assert flight.autopilot.parameters["MIS_TAKEOFF_ALT"] == 1.25
    assert failures.of(Unit.MAGNETOMETER) is Kind.OFF
    flight.run(0.9)
    assert flight.status.battery_norm > 0.9
    flight.run(0.2)
    assert flight.status.battery_norm == pytest.approx(0.5, abs=0.01)
    assert failures.works(Unit.OPTICAL_FLOW)
    flight.run(1.0)
    assert failures.of(Unit.OPTICAL_FLOW) is Kind.STUCK


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"parameters": {"NO_SUCH": 1.0}}, r"^sitl.parameters.NO_SUCH: "),
        ({"parameters": {"MPC_XY_P": 99.0}}, r"^sitl.parameters.MPC_XY_P: 99: allowed: 0 to 2"),
        (
            {"faults": {"failures": {"battery": "stuck"}}},
            r"^sitl.faults.failures.battery: .*allowed: off, ok",
        ),
        (
            {"events": [{"at_s": 1e3, "failures": {"sticks": "garbage"}}]},
            r"^sitl.events\[0\].failures.sticks",
        ),
        ({"events": [{"at_s": 9.0, "parameters": {"X": 1.0}}]}, r"^sitl.events\[0\].parameters.X"),
    ],
)
def test_impossible_faults_are_refused_before_anything_moves(make_flight, table, says):
    with pytest.raises(PlanError, match=says):
        make_flight(settings=convert_settings(table, SitlSettings, "sitl"))


def test_a_broken_camera_shows_nothing_the_same_or_noise(tmp_path):
    room = tmp_path / "hall.toml"
    room.write_text("size_m = [6.0, 6.0, 3.0]\n", encoding="utf-8")
    simulation = build(room, {}, 1, 10.0)
    failures = simulation.world.autopilot.failures
    sound = [simulation.next_frame() for _ in range(2)]
    assert not np.array_equal(sound[0].left, sound[1].left)
    failures.inject(Unit.CAMERA, Kind.STUCK)
    stuck = simulation.next_frame()
    assert stuck.stamp_ns > sound[1].stamp_ns
    assert np.array_equal(stuck.left, sound[1].left)
    failures.inject(Unit.CAMERA, Kind.GARBAGE)
    left = simulation.next_frame().left.astype(float)
    assert abs(np.corrcoef(left[:, 1:].ravel(), left[:, :-1].ravel())[0, 1]) < 0.05
    failures.inject(Unit.CAMERA, Kind.OFF)
    assert simulation.next_frame() is None
    failures.inject(Unit.CAMERA, Kind.OK)
    assert simulation.next_frame().stamp_ns > stuck.stamp_ns
