"""DO_ORBIT, against the truth."""

import math

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import wrap_angle_rad
from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Ack, OrbitRequest
from sitl.mavlink.places import Origin
from sitl.settings import EstimatorSettings, SitlSettings

NAN = math.nan
EXACT = EstimatorSettings(
    velocity_bias_m_s=0.0,
    velocity_noise_m_s=0.0,
    height_error_m=0.0,
    attitude_error_deg=0.0,
    yaw_error_deg=0.0,
)
CENTRE = (4.0, -2.0)


@pytest.fixture
def flight(make_flight):
    flight = make_flight(settings=SitlSettings(estimator=EXACT))
    flight.take_off(2.0)
    return flight


def orbit(flight, radius_m=2.0, speed_m_s=1.0, yaw=0, centre=(*CENTRE, -2.0)):
    return flight.autopilot.orbit(OrbitRequest(radius_m, speed_m_s, yaw, centre))


def polar(flight):
    """Distance and direction of the vehicle from the centre."""
    north_m, east_m, _ = flight.world.truth.position_ned_m
    d_north, d_east = north_m - CENTRE[0], east_m - CENTRE[1]
    return math.hypot(d_north, d_east), math.atan2(d_east, d_north)


@pytest.mark.parametrize(
    ("radius_m", "speed_m_s", "yaw", "beside_centre_rad"),
    [(2.0, 1.0, 0, 0.0), (-3.0, 1.5, 3, math.pi / 2), (-1.0, 0.5, 0, 0.0)],
)
def test_the_circle_is_flown_as_asked(flight, radius_m, speed_m_s, yaw, beside_centre_rad):
    assert orbit(flight, radius_m, speed_m_s, yaw) is Ack.ACCEPTED
    flight.run(11.0)
    turned_rad, (_, before_rad) = 0.0, polar(flight)
    for _ in range(20):
        flight.run(0.3)
        distance_m, angle_rad = polar(flight)
        turned_rad += wrap_angle_rad(angle_rad - before_rad)
        before_rad = angle_rad
        assert distance_m == pytest.approx(abs(radius_m), abs=0.1)
        beside_rad = flight.world.truth.euler_rad[2] - angle_rad - math.pi - beside_centre_rad
        assert wrap_angle_rad(beside_rad) == pytest.approx(0.0, abs=0.15)
    assert turned_rad / 6.0 == pytest.approx(speed_m_s / radius_m, rel=0.06)
    assert flight.world.truth.position_ned_m[2] == pytest.approx(-2.0, abs=0.1)


def test_a_tight_circle_is_flown_slower_and_the_heading_kept_when_asked(flight):
    start_rad = flight.world.truth.euler_rad[2]
    orbit(flight, 1.0, 5.0, 1)
    flight.run(10.0)
    speed_m_s = math.hypot(*flight.world.truth.velocity_ned_m_s[:2])
    assert speed_m_s == pytest.approx(math.sqrt(2.0), abs=0.15)  # 2 m/s2 towards the centre
    assert flight.world.truth.euler_rad[2] == pytest.approx(start_rad, abs=0.1)


def test_a_second_request_changes_only_what_it_gives_and_a_retry_nothing(flight):
    orbit(flight)
    flight.run(8.0)
    orbit(flight)
    flight.run(0.5)
    assert polar(flight)[0] == pytest.approx(2.0, abs=0.15)
    assert flight.autopilot.orbit(OrbitRequest(3.0)) is Ack.ACCEPTED
    flight.run(8.0)
    assert polar(flight)[0] == pytest.approx(3.0, abs=0.1)
    assert flight.world.truth.position_ned_m[2] == pytest.approx(-2.0, abs=0.1)


def test_a_failsafe_interrupts_it(flight):
    orbit(flight)
    flight.run(1.0)
    flight.autopilot.set_parameter("GF_MAX_VER_DIST", 1.0)
    flight.run(0.2)
    assert flight.status.mode is FlightMode.HOLD
    assert flight.status.intended_mode is FlightMode.ORBIT
    assert flight.status.orbit is None


def command(flight, radius_m, centre):
    north_m, east_m, down_m = centre
    place = round(north_m * 1e4), round(east_m * 1e4), down_m
    frame = mavlink.MAV_FRAME_LOCAL_NED
    flight.client.received()
    flight.client.send(
        mavlink.MAVLink_command_int_message(
            *(1, 1, frame, mavlink.MAV_CMD_DO_ORBIT, 0, 0), radius_m, 1.0, 0.0, NAN, *place
        )
    )
    return [m.result for m in flight.answers("COMMAND_ACK")]


def test_it_is_told_while_it_is_flown(fly_mavlink):
    flight = fly_mavlink()
    flight.run(3.0)
    assert command(flight, 2.0, (*CENTRE, -2.0)) == [Ack.TEMPORARILY_REJECTED]  # on the ground
    flight.take_off()
    assert command(flight, 2.0, (50_000.0, 0.0, -2.0)) == [Ack.DENIED]
    assert command(flight, -2.0, (*CENTRE, -2.0)) == [Ack.ACCEPTED]
    messages = flight.run(4.0)
    told = [m for m in messages if m.get_type() == "ORBIT_EXECUTION_STATUS"]
    assert len(told) == pytest.approx(8, abs=1)
    latitude_deg, longitude_deg = Origin().degrees((*CENTRE, 0.0))
    assert (told[-1].x, told[-1].y) == (round(latitude_deg * 1e7), round(longitude_deg * 1e7))
    assert (told[-1].radius, told[-1].z) == (-2.0, 12.0)
    heartbeat = [m for m in messages if m.get_type() == "HEARTBEAT"][-1]
    assert (heartbeat.base_mode, heartbeat.custom_mode) == (145, 0x01030000)
    assert flight.acks(mavlink.MAV_CMD_NAV_LOITER_UNLIM) == [Ack.ACCEPTED]
    flight.run(0.1)
    assert "ORBIT_EXECUTION_STATUS" not in {m.get_type() for m in flight.run(2.0)}
    assert flight.acks(mavlink.MAV_CMD_REQUEST_MESSAGE, 360.0) == [Ack.DENIED]
