"""A desk is an obstacle in flight, and ground to land on."""

from pathlib import Path

import pytest

from companion.kernel.messages import FlightMode
from sitl.arena.contact import RoomContact
from sitl.arena.room import BoxSettings, RoomSettings, build_room
from sitl.settings import SitlSettings
from sitl.simulator import World

ROOM = build_room(
    RoomSettings(
        size_m=(6.0, 6.0, 3.0),
        box=(BoxSettings(centre_m=(1.5, 0.0, 0.3), size_m=(1.6, 1.6, 0.6)),),
    ),
    Path("room.toml"),
)


def fly_over(flight, ahead_s):
    flight.world = World(ROOM, SitlSettings(), 1, RoomContact(ROOM))
    flight.autopilot = flight.world.autopilot
    flight.take_off(1.4)
    flight.fly(ahead_s, north_m_s=0.5)
    flight.fly(2.0)


@pytest.fixture
def over_the_desk(make_flight):
    flight = make_flight()
    fly_over(flight, 3.2)
    assert 1.1 < flight.world.truth.position_ned_m[0] < 1.9
    assert flight.world.collisions == 0
    return flight


def test_landing_on_it_is_no_collision(over_the_desk):
    flight = over_the_desk
    flight.autopilot.land()
    flight.wait_until(lambda: not flight.status.armed, 20.0)
    assert flight.world.truth.position_ned_m[2] < -0.6
    assert flight.world.collisions == 0
    assert (flight.world.crashed, flight.world.fell) == (None, False)


def test_a_fall_off_its_edge_is_none_of_the_flight(make_flight):
    """A hull that hangs on the edge slides down once its motors are off."""
    flight = make_flight()
    fly_over(flight, 1.38)
    flight.autopilot.land()
    flight.wait_until(lambda: not flight.status.armed, 20.0)
    flight.world.advance_to(flight.world.time_s + 5.0)
    assert flight.world.crashed.startswith("hit the floor at")
    assert flight.world.fell


def test_motors_that_stop_in_flight_are_a_crash_of_it(make_flight):
    flight = make_flight()
    fly_over(flight, 0.0)
    flight.autopilot.disarm(force=True)
    flight.world.advance_to(flight.world.time_s + 3.0)
    assert flight.world.crashed.startswith("hit the floor at")
    assert not flight.world.fell


def test_sinking_onto_it_in_flight_is_one(over_the_desk):
    over_the_desk.fly(2.5, down_m_s=0.4)
    assert over_the_desk.status.mode is FlightMode.OFFBOARD
    assert over_the_desk.world.collisions == 1
