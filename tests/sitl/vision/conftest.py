"""A flight whose estimate drifts, and motion capture of it."""

import math

import numpy as np
import pytest

from companion.kernel.frames import quaternion_from_euler
from sitl.autopilot.estimation.vision_sample import VisionSample
from sitl.settings import EstimatorSettings, SitlSettings

DRIFT_M_S = 0.2
DRIFTING = SitlSettings(estimator=EstimatorSettings(drift_ned_m_s=(DRIFT_M_S, 0.0, 0.0)))
HZ = 30


class Mocap:
    """Motion capture of one flight, ``noise_m`` exact, in the frame whose origin is home."""

    def __init__(self, flight, noise_m=0.005):
        self.flight = flight
        self.noise_m = noise_m
        self.rng = np.random.default_rng(5)
        self.seen = []

    def look(self, **changes):
        world = self.flight.world
        truth, home_m = world.truth, world.room_from_home_m
        place_m = np.subtract(truth.position_ned_m, home_m)
        sample = VisionSample(
            world.time_s,
            tuple(place_m + self.noise_m * self.rng.standard_normal(3)),
            quaternion_from_euler(*truth.euler_rad),
        )
        self.seen.append(sample)
        return sample._replace(**changes)

    def send(self, **changes):
        self.flight.autopilot.take_vision(self.look(**changes))

    def run(self, duration_s, send=None):
        """Lets the flight go on, and hands over a sample at every frame of the cameras."""
        for _ in range(round(duration_s * HZ)):
            (send or self.send)()
            self.flight.world.advance_to(self.flight.world.time_s + 1 / HZ)

    def error_m(self):
        """(level, down) of the estimate."""
        truth, home_m = self.flight.world.truth, self.flight.world.room_from_home_m
        north, east, down = np.subtract(
            self.flight.autopilot.estimate.position_ned_m,
            np.subtract(truth.position_ned_m, home_m),
        )
        return math.hypot(north, east), abs(down)


@pytest.fixture(scope="session")
def drift_m_s():
    return DRIFT_M_S


@pytest.fixture(scope="session")
def drifting_settings():
    """The estimate of the place walks north by ``drift_m_s``."""
    return DRIFTING


@pytest.fixture(scope="session")
def make_mocap():
    """``make_mocap(flight, noise_m=0.005)``: motion capture of that flight."""
    return Mocap


@pytest.fixture
def drifting(make_flight):
    return Mocap(make_flight(settings=DRIFTING))
