"""A vehicle in a hall without obstacles, for tests of the autopilot and the world."""

import math
from typing import NamedTuple

import pytest

from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Ack, OffboardSetpoint
from sitl.settings import SitlSettings
from sitl.simulator import World


class Hall(NamedTuple):
    """Four walls and a ceiling; the start may lie anywhere on the floor."""

    half_m: float = 50.0
    height_m: float = 50.0
    start_position_ned_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start_yaw_rad: float = 0.0

    def nearest(self, position_ned_m):
        north, east, down = position_ned_m
        return min(
            (self.half_m - north, (-1.0, 0.0, 0.0)),
            (self.half_m + north, (1.0, 0.0, 0.0)),
            (self.half_m - east, (0.0, -1.0, 0.0)),
            (self.half_m + east, (0.0, 1.0, 0.0)),
            (self.height_m + down, (0.0, 0.0, 1.0)),
        )


class FlightCard:
    """Verbs of a test flight; limits are in simulated seconds."""

    def __init__(self, hall=None, settings=None, seed=1):
        hall = hall or Hall()
        self.world = World(hall, settings or SitlSettings(), seed, surfaces=hall)
        self.autopilot = self.world.autopilot
        self.texts = []
        self.states = []

    @property
    def status(self):
        return self.autopilot.status

    def run(self, duration_s, each=lambda: None):
        """Advances by ``duration_s``, calling ``each`` ten times a second; collects texts."""
        for _ in range(round(duration_s * 10)):
            each()
            for _ in range(5):
                self.world.advance_to(self.world.time_s + 0.02)
                self.states.append(self.world.truth)
            self.texts += self.autopilot.drain_status_texts()
        return self.world.truth

    def wait_until(self, condition, limit_s):
        """Time when ``condition()`` became true."""
        start_s = self.world.time_s
        while not condition():
            assert self.world.time_s < start_s + limit_s, f"not within {limit_s} s"
            self.world.step()
        self.texts += self.autopilot.drain_status_texts()
        return self.world.time_s

    def get_ready(self):
        self.wait_until(lambda: self.status.ready_to_arm, 5.0)

    def take_off(self, height_m=1.5):
        """Arms, climbs, and settles in HOLD."""
        self.get_ready()
        assert self.autopilot.arm() is Ack.ACCEPTED
        assert self.autopilot.take_off(height_m) is Ack.ACCEPTED
        self.wait_until(lambda: self.status.mode is FlightMode.HOLD, 15.0)
        self.run(3.0)

    def send(self, north_m_s=0.0, east_m_s=0.0, down_m_s=0.0, yaw_rate_rad_s=math.nan):
        self.autopilot.set_offboard_setpoint(
            OffboardSetpoint(
                velocity_ned_m_s=(north_m_s, east_m_s, down_m_s), yaw_rate_rad_s=yaw_rate_rad_s
            )
        )

    def fly(self, duration_s, **velocity):
        """Streams this setpoint in offboard mode; the states on the way."""
        self.send(**velocity)
        if self.status.mode is not FlightMode.OFFBOARD:
            assert self.autopilot.set_mode(FlightMode.OFFBOARD) is Ack.ACCEPTED
        first = len(self.states)
        self.run(duration_s, lambda: self.send(**velocity))
        return self.states[first:]

    def said(self, text):
        """Times at which this status text came."""
        self.texts += self.autopilot.drain_status_texts()
        return [entry.time_s for entry in self.texts if entry.text == text]


@pytest.fixture
def make_flight():
    """Builds a flight: ``make_flight(hall=..., settings=..., seed=...)``."""
    return FlightCard


@pytest.fixture
def make_hall():
    return Hall


@pytest.fixture
def flight():
    return FlightCard()


@pytest.fixture
def airborne(flight):
    flight.take_off()
    return flight
