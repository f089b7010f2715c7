"""How the vehicle flies: arming, take-off, tracking, landing; PX4's words and times."""

import math

import pytest

from companion.kernel.messages import FlightMode, LandedState
from sitl.autopilot.interface import Ack, AutopilotPort, OffboardSetpoint
from sitl.settings import EstimatorSettings, SitlSettings

QUIET = SitlSettings(
    estimator=EstimatorSettings(
        velocity_bias_m_s=0.0,
        velocity_noise_m_s=0.0,
        height_error_m=0.0,
        attitude_error_deg=0.0,
        yaw_error_deg=0.0,
    )
)


def test_arming_is_refused_until_the_estimate_is_ready(flight):
    flight.run(1.0)
    assert not flight.status.ready_to_arm
    assert flight.autopilot.arm() is Ack.TEMPORARILY_REJECTED
    assert flight.said("Arming denied: no valid local position estimate")
    flight.run(1.2)
    assert flight.status.ready_to_arm
    assert flight.said("Ready for takeoff!") == [pytest.approx(2.0, abs=0.03)]
    assert flight.autopilot.arm() is Ack.ACCEPTED
    assert flight.status.armed
    assert flight.said("Armed by external command")


def test_armed_without_take_off_it_disarms_after_ten_seconds(flight):
    flight.get_ready()
    armed_s = flight.world.time_s
    flight.autopilot.arm()
    disarmed_s = flight.wait_until(lambda: not flight.status.armed, 12.0)
    assert disarmed_s - armed_s == pytest.approx(10.0, abs=0.05)
    assert flight.said("Disarmed by auto preflight disarming")


def test_take_off_goes_through_the_landed_states_to_hold(flight):
    flight.get_ready()
    start_s = flight.world.time_s
    flight.autopilot.arm()
    assert flight.autopilot.take_off() is Ack.ACCEPTED
    flight.run(0.9)
    assert flight.status.landed_state is LandedState.ON_GROUND  # spooling up
    assert max(flight.status.motors_norm) < 0.1
    flight.wait_until(lambda: flight.status.landed_state is LandedState.TAKING_OFF, 0.3)
    assert flight.status.mode is FlightMode.TAKEOFF
    flight.wait_until(lambda: flight.status.landed_state is LandedState.IN_AIR, 4.0)
    hold_s = flight.wait_until(lambda: flight.status.mode is FlightMode.HOLD, 6.0)
    assert 5.0 < hold_s - start_s < 8.0
    assert flight.said("Takeoff detected")
    flight.run(2.0)
    assert -flight.world.truth.position_ned_m[2] == pytest.approx(2.5, abs=0.1)


def test_hold_keeps_height_and_place(airborne):
    start = airborne.world.truth.position_ned_m
    airborne.run(20.0)
    heights = [-state.position_ned_m[2] for state in airborne.states[-1000:]]
    # Home's origin is the centre of mass, 6 cm above the floor.
    assert all(abs(height - 1.5 - 0.058) < 0.05 for height in heights)
    assert math.dist(start, airborne.world.truth.position_ned_m) < 0.4  # estimate drifts


@pytest.mark.parametrize("seed", [1, 2])
def test_velocity_is_tracked(make_flight, seed):
    flight = make_flight(settings=QUIET, seed=seed)
    flight.take_off()
    speeds = [state.velocity_ned_m_s[0] for state in flight.fly(5.0, north_m_s=0.5)]
    assert max(speeds) < 0.5 * 1.1
    assert all(abs(speed - 0.5) < 0.03 for speed in speeds[75:])


def test_it_starts_and_stops_gently_within_a_third_of_a_metre(airborne):
    states = airborne.fly(4.0, north_m_s=0.5)
    brake_m = airborne.world.truth.position_ned_m[0]
    states += airborne.fly(3.0)
    assert max(state.position_ned_m[0] for state in states) - brake_m < 0.35
    tilts = [max(abs(angle) for angle in state.euler_rad[:2]) for state in states]
    assert math.degrees(max(tilts)) < 10.0
    heights = [state.position_ned_m[2] for state in states]
    assert max(heights) - min(heights) < 0.08


def test_offboard_flies_in_ned_whatever_the_heading(make_flight, make_hall):
    flight = make_flight(hall=make_hall(start_yaw_rad=2.0), settings=QUIET)
    flight.take_off()
    state = flight.fly(3.0, north_m_s=-0.4, east_m_s=0.3)[-1]
    assert state.velocity_ned_m_s == pytest.approx((-0.4, 0.3, 0.0), abs=0.03)
    assert state.euler_rad[2] == pytest.approx(2.0, abs=0.02)


def test_a_turn_follows_its_rate_and_keeps_the_heading_it_ends_at(airborne):
    rates = [state.rates_frd_rad_s[2] for state in airborne.fly(3.0, yaw_rate_rad_s=0.5)]
    assert max(rates) < 1.1 * 0.5
    assert rates[-1] == pytest.approx(0.5, abs=0.02)
    airborne.fly(1.5, yaw_rate_rad_s=0.0)
    heading = airborne.world.truth.euler_rad[2]
    airborne.fly(5.0, yaw_rate_rad_s=0.0)
    assert airborne.world.truth.euler_rad[2] == pytest.approx(heading, abs=math.radians(1.0))


def test_height_stays_while_flying_and_turning(airborne):
    start_m = airborne.world.truth.position_ned_m[2]
    for _ in range(5):
        airborne.fly(2.0, north_m_s=0.5)
        airborne.fly(2.0, yaw_rate_rad_s=0.6)
        airborne.fly(2.0, north_m_s=-0.5)
    assert airborne.world.truth.position_ned_m[2] == pytest.approx(start_m, abs=0.08)


def test_vertical_velocity_climbs_and_then_holds(airborne):
    start_m = airborne.world.truth.position_ned_m[2]
    airborne.fly(2.0, down_m_s=-0.4)
    top_m = airborne.fly(2.0)[-1].position_ned_m[2]
    assert start_m - top_m == pytest.approx(0.8, abs=0.15)
    assert airborne.fly(4.0)[-1].position_ned_m[2] == pytest.approx(top_m, abs=0.05)


def test_position_and_yaw_setpoints_are_reached(airborne):
    target = OffboardSetpoint(position_ned_m=(1.0, -0.5, -2.0), yaw_rad=-1.0)
    airborne.autopilot.set_offboard_setpoint(target)
    airborne.autopilot.set_mode(FlightMode.OFFBOARD)
    airborne.run(8.0, lambda: airborne.autopilot.set_offboard_setpoint(target))
    estimate = airborne.autopilot.estimate
    assert estimate.position_ned_m == pytest.approx((1.0, -0.5, -2.0), abs=0.1)
    assert estimate.yaw_rad == pytest.approx(-1.0, abs=0.05)


def test_offboard_takes_off_from_the_ground(flight):
    flight.get_ready()
    flight.send(down_m_s=-0.5)
    assert flight.autopilot.set_mode(FlightMode.OFFBOARD) is Ack.ACCEPTED
    assert flight.autopilot.arm() is Ack.ACCEPTED
    flight.run(5.0, lambda: flight.send(down_m_s=-0.5))
    assert flight.status.landed_state is LandedState.IN_AIR
    assert -flight.world.truth.position_ned_m[2] > 0.8


def test_landing_is_slow_detected_and_disarms(airborne):
    assert airborne.autopilot.land() is Ack.ACCEPTED
    airborne.run(1.5)
    assert airborne.status.landed_state is LandedState.LANDING
    assert airborne.world.truth.velocity_ned_m_s[2] == pytest.approx(0.7, abs=0.1)
    airborne.wait_until(lambda: not airborne.status.armed, 10.0)
    (landed_s,) = airborne.said("Landing detected")
    assert airborne.world.time_s - landed_s == pytest.approx(2.0, abs=0.05)
    assert airborne.said("Disarmed by landing")
    assert airborne.world.crashed is None
    assert airborne.world.collisions == 0
    assert airborne.status.mode is FlightMode.HOLD


def test_it_flies_again_after_a_landing(airborne):
    airborne.autopilot.land()
    airborne.wait_until(lambda: not airborne.status.armed, 10.0)
    airborne.take_off(1.0)
    assert airborne.autopilot.estimate.position_ned_m[2] == pytest.approx(-1.0, abs=0.1)


def test_land_can_be_called_off(airborne):
    airborne.autopilot.land()
    airborne.run(0.8)
    airborne.autopilot.set_mode(FlightMode.HOLD)
    airborne.run(5.0)
    assert airborne.status.landed_state is LandedState.IN_AIR


@pytest.mark.parametrize("mode", [FlightMode.MANUAL, FlightMode.POSITION, FlightMode.MISSION])
def test_modes_that_need_sticks_or_a_plan_are_refused_without(airborne, mode):
    assert airborne.autopilot.set_mode(mode) is Ack.TEMPORARILY_REJECTED
    assert airborne.status.mode is FlightMode.HOLD
    assert airborne.said(f"Mode {mode.value} is not available now")


def test_what_is_in_the_air_is_not_disarmed_unless_forced(airborne):
    assert airborne.autopilot.disarm() is Ack.TEMPORARILY_REJECTED
    assert airborne.status.armed
    assert airborne.autopilot.take_off() is Ack.TEMPORARILY_REJECTED
    assert airborne.autopilot.disarm(force=True) is Ack.ACCEPTED
    assert airborne.run(0.4).velocity_ned_m_s[2] > 1.5


@pytest.mark.parametrize("height_m", [0.0, -1.0, math.inf])
def test_heights_that_cannot_be_flown_are_denied(flight, height_m):
    assert flight.autopilot.take_off(height_m) is Ack.DENIED


def test_parameters_act_within_their_ranges_and_keep_their_types(flight):
    autopilot: AutopilotPort = flight.autopilot
    assert not autopilot.set_parameter("NO_SUCH", 1.0)
    assert not autopilot.set_parameter("MIS_TAKEOFF_ALT", -1.0)
    assert not autopilot.set_parameter("MIS_TAKEOFF_ALT", math.nan)
    assert autopilot.set_parameter("COM_OBL_RC_ACT", 5.0)
    assert isinstance(autopilot.parameters["COM_OBL_RC_ACT"], int)
    assert autopilot.set_parameter("MIS_TAKEOFF_ALT", 1)
    assert isinstance(autopilot.parameters["MIS_TAKEOFF_ALT"], float)
    flight.get_ready()
    flight.autopilot.arm()
    flight.autopilot.take_off()
    flight.run(10.0)
    assert autopilot.estimate.position_ned_m[2] == pytest.approx(-1.0, abs=0.06)


def test_the_estimate_walks_away_as_configured(make_flight):
    """Spread over seeds of the drift after 20 s at rest, against the settings' formula."""
    drifts = []
    for seed in range(12):
        flight = make_flight(seed=seed)
        flight.run(20.0)
        drifts += flight.autopilot.estimate.position_ned_m[:2]
    spread_m = math.sqrt(sum(drift * drift for drift in drifts) / len(drifts))
    # Integral of a Gauss-Markov process started at 0, after two of its correlation times.
    formula = 4.0 - 3.0 + 4.0 * math.exp(-2.0) - math.exp(-4.0)
    assert spread_m == pytest.approx(0.01 * 10.0 * math.sqrt(formula), rel=0.4)


def test_a_fast_way_to_a_place_ends_there(flight):
    flight.take_off()
    flight.autopilot.set_parameter("MPC_XY_VEL_MAX", 5.0)
    place = OffboardSetpoint(position_ned_m=(30.0, 0.0, -1.5))
    flight.autopilot.set_offboard_setpoint(place)
    flight.autopilot.set_mode(FlightMode.OFFBOARD)
    flight.run(20.0, lambda: flight.autopilot.set_offboard_setpoint(place))
    norths_m = [state.position_ned_m[0] for state in flight.states]
    assert max(state.velocity_ned_m_s[0] for state in flight.states) > 4.5
    assert max(norths_m) < 30.5
    assert norths_m[-1] == pytest.approx(30.0, abs=0.3)
