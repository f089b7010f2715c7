"""The world: contact, crashes, motion capture, step ratios, repeatability."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.kernel.errors import PlanError
from companion.kernel.messages import FlightMode
from sitl.hull import HULL_RADIUS_M, push_ned_n
from sitl.settings import SitlSettings
from sitl.simulator import World


@pytest.fixture
def room(make_hall):
    return make_hall(half_m=2.5, height_m=3.0)


def test_the_same_seed_gives_the_same_flight(make_flight, room):
    def poses(seed):
        flight = make_flight(hall=room, seed=seed)
        flight.take_off(1.0)
        flight.fly(3.0, north_m_s=0.4, yaw_rate_rad_s=0.2)
        return list(flight.world.mocap)

    assert poses(7) == poses(7)
    assert poses(7) != poses(8)


def test_a_slow_bump_is_pushed_back_and_counted_once(make_flight, room):
    flight = make_flight(hall=room)
    flight.take_off(1.0)
    flight.fly(8.0, north_m_s=0.4)  # leans on the wall for seconds
    assert flight.world.collisions == 1
    assert flight.world.crashed is None
    assert -0.05 < flight.world.minimum_clearance_m < 0.0
    assert flight.world.truth.position_ned_m[0] < 2.5 - HULL_RADIUS_M + 0.05
    flight.fly(4.0, north_m_s=-0.4)
    flight.fly(6.0, north_m_s=0.4)
    assert flight.world.collisions == 2


UNIT = st.floats(-1.0, 1.0)


@given(
    clearance_m=st.floats(-0.2, 0.2),
    normal=st.tuples(UNIT, UNIT, UNIT).filter(lambda n: math.hypot(*n) > 0.1),
    velocity=st.tuples(UNIT, UNIT, UNIT),
)
def test_a_surface_pushes_out_and_brakes_never_pulls_or_drives(clearance_m, normal, velocity):
    normal = tuple(axis / math.hypot(*normal) for axis in normal)
    force = push_ned_n(clearance_m, normal, velocity)
    outwards_n = sum(f * n for f, n in zip(force, normal, strict=True))
    assert outwards_n >= -1e-9
    leaving_m_s = sum(v * n for v, n in zip(velocity, normal, strict=True))
    sliding = [v - leaving_m_s * n for v, n in zip(velocity, normal, strict=True)]
    assert sum(f * s for f, s in zip(force, sliding, strict=True)) <= 1e-9
    if clearance_m >= 0.0:
        assert force == (0.0, 0.0, 0.0)


def test_a_bump_gives_no_energy(make_flight, room):
    flight = make_flight(hall=room)
    flight.take_off(1.0)
    flight.fly(3.5, north_m_s=0.8)
    states = flight.fly(3.0)
    assert flight.world.collisions == 1
    assert min(state.velocity_ned_m_s[0] for state in states) > -0.8


def test_a_fast_one_is_a_crash_and_stops_the_motors(make_flight, room):
    flight = make_flight(hall=room)
    flight.take_off(1.0)
    flight.fly(4.0, north_m_s=1.6)
    assert flight.world.crashed is not None
    assert flight.world.crashed.startswith("hit the room at 1.")
    assert not flight.status.armed
    assert flight.world.collisions == 1
    flight.run(2.0)
    assert max(flight.status.motors_norm) < 0.01
    assert abs(flight.world.truth.position_ned_m[2]) < 0.2


def test_the_ceiling_counts(make_flight, room):
    flight = make_flight(hall=room)
    flight.take_off(2.0)
    flight.fly(3.0, down_m_s=-0.5)
    assert flight.world.collisions == 1


def test_the_floor_counts_in_flight_but_not_for_take_off_and_landing(make_flight, room):
    flight = make_flight(hall=room)
    flight.take_off(0.5)
    assert flight.world.collisions == 0
    flight.fly(1.6, down_m_s=0.5)
    assert flight.world.collisions == 1
    assert flight.world.crashed is None


def test_falling_on_the_floor_is_a_crash(make_flight, room):
    flight = make_flight(hall=room)
    flight.take_off(1.0)
    flight.autopilot.disarm(force=True)
    flight.run(2.0)
    assert flight.world.crashed is not None
    assert flight.world.crashed.startswith("hit the floor at 4.")


def test_motion_capture_sees_the_truth_in_room_coordinates_at_100_hz(make_flight, make_hall):
    hall = make_hall(
        half_m=2.5, height_m=3.0, start_position_ned_m=(1.0, -0.5, 0.0), start_yaw_rad=1.0
    )
    flight = make_flight(hall=hall)
    flight.run(2.0)
    poses = list(flight.world.mocap)
    assert len(poses) == 200
    assert [pose.stamp_ns for pose in poses[:3]] == [0, 10_000_000, 20_000_000]
    assert poses[-1].truth_position_ned_m == pytest.approx((1.0, -0.5, -0.058), abs=1e-3)
    w, _, _, z = poses[-1].truth_ned_from_frd
    assert 2 * math.atan2(z, w) == pytest.approx(1.0, abs=1e-6)
    assert poses[-1].truth_clearance_m == pytest.approx(1.5 - HULL_RADIUS_M, abs=1e-3)
    assert flight.autopilot.estimate.position_ned_m == pytest.approx((0, 0, 0), abs=0.1)
    flight.take_off(1.0)
    assert flight.world.truth.position_ned_m[:2] == pytest.approx((1.0, -0.5), abs=0.3)


def test_distance_flown_counts_flight_only(make_flight, room):
    flight = make_flight(hall=room)
    flight.run(3.0)
    assert flight.world.distance_flown_m == 0.0
    flight.take_off(1.0)
    before_m = flight.world.distance_flown_m
    assert before_m == pytest.approx(1.0, abs=0.2)
    flight.fly(4.0, east_m_s=0.4)
    assert flight.world.distance_flown_m - before_m == pytest.approx(1.55, abs=0.15)


@pytest.mark.parametrize("rate_hz", [10, 15, 20, 25, 30, 50, 60, 100])
def test_common_camera_rates_divide_the_physics(flight, rate_hz):
    assert flight.world.whole_steps(rate_hz, "camera rate") * rate_hz == 300


@pytest.mark.parametrize(
    ("rate_hz", "nearest"),
    [(33, "nearest: 30 Hz or 33.3333 Hz"), (400, "nearest: 300 Hz"), (0, "nearest: 300 Hz")],
)
def test_other_rates_are_refused_with_the_nearest(flight, rate_hz, nearest):
    with pytest.raises(PlanError, match=f"camera rate {rate_hz} Hz: .* 1/300 s; {nearest}"):
        flight.world.whole_steps(rate_hz, "camera rate")


def test_physics_that_does_not_fit_the_control_rate_is_refused(room):
    with pytest.raises(PlanError, match="control rate 50 Hz"):
        World(room, SitlSettings(physics_hz=333), 1, surfaces=room)


def test_a_start_inside_a_wall_is_refused(make_hall):
    hall = make_hall(half_m=2.5, start_position_ned_m=(2.4, 0.0, 0.0))
    with pytest.raises(PlanError, match=r"start\.position_m: the hull reaches 0\.16 m into a wall"):
        World(hall, SitlSettings(), 1, surfaces=hall)


def test_advance_to_ends_on_the_step_nearest_to_the_time(flight):
    flight.world.advance_to(0.1)
    assert flight.world.time_s == pytest.approx(0.1)
    assert flight.world.stamp_ns == 100_000_000
    flight.world.advance_to(0.05)
    assert flight.world.time_s == pytest.approx(0.1)
    assert flight.status.mode is FlightMode.HOLD


def test_an_injected_wind_outlives_a_change_of_parameters(airborne):
    def tilt_rad():
        airborne.run(6.0)
        return sum(state.euler_rad[1] for state in airborne.states[-100:]) / 100

    calm_rad = tilt_rad()
    airborne.world.surroundings.wind_ned_m_s = (3.0, 0.0, 0.0)
    windy_rad = tilt_rad()
    airborne.autopilot.set_parameter("MC_ROLLRATE_K", 1.1)
    assert windy_rad > calm_rad + 0.05  # leans back against wind from behind
    assert tilt_rad() == pytest.approx(windy_rad, abs=0.02)
    airborne.autopilot.set_parameter("SIH_WIND_N", 3.0)  # comes from the north: both cancel
    assert tilt_rad() == pytest.approx(calm_rad, abs=0.02)


def test_parameters_of_the_plan_are_set_from_the_start_or_refused(make_flight):
    flight = make_flight(settings=SitlSettings(parameters={"MIS_TAKEOFF_ALT": 1.25}))
    assert flight.autopilot.parameters["MIS_TAKEOFF_ALT"] == 1.25
    with pytest.raises(PlanError, match=r"sitl.parameters.MIS_TAKEOFF_ALTX: .* 'MIS_TAKEOFF_ALT'"):
        make_flight(settings=SitlSettings(parameters={"MIS_TAKEOFF_ALTX": 1.0}))
    with pytest.raises(PlanError, match=r"sitl.parameters.COM_OBL_RC_ACT: 9: allowed: 0 to 7"):
        make_flight(settings=SitlSettings(parameters={"COM_OBL_RC_ACT": 9.0}))
