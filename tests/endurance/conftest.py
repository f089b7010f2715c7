"""What a vehicle must bear for long: briefly in the ordinary run, as long as asked by options."""

import os
import resource
import socket
from collections import deque
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from pymavlink.dialects.v20 import development

from sitl.mavlink.links import open_link
from sitl.mavlink.server import MavlinkServer
from sitl.settings import BatterySettings, EstimatorSettings, SitlSettings
from sitl.simulator import World

TAKEN_OFF_S = 15.0
STEADY = SitlSettings(
    battery=BatterySettings(capacity_mah=1e9), estimator=EstimatorSettings(velocity_bias_m_s=0.0)
)
"""A battery for days, and an estimate that does not drift out of the hall in them."""


def pytest_addoption(parser):
    parser.addoption("--kills", type=int, default=1, help="clients killed in offboard")
    parser.addoption("--hostile-bytes", type=int, default=30_000, help="on each kind of link")
    parser.addoption("--soak-hours", type=float, default=0.01, help="of flight")


@pytest.fixture
def option(request):
    """``option("kills")``: what was asked for, or the little that the ordinary run does."""
    defaults = {"kills": 1, "hostile_bytes": 30_000, "soak_hours": 0.01}
    return lambda name: request.config.getoption(name, default=defaults[name])


@pytest.fixture
def say(record_property):
    """``say(line)``: printed at the end."""
    return lambda line: record_property("endurance", line)


def pytest_terminal_summary(terminalreporter):
    for report in terminalreporter.getreports("passed") + terminalreporter.getreports("failed"):
        for key, line in report.user_properties:
            if key == "endurance":
                terminalreporter.line(line)


class Hall:
    """Empty, 100 x 100 m."""

    start_position_ned_m = (0.0, 0.0, 0.0)
    start_yaw_rad = 0.0

    def nearest(self, position_ned_m):
        north_m, east_m, _ = position_ned_m
        walls = (
            (50.0 - north_m, (-1.0, 0.0, 0.0)),
            (50.0 + north_m, (1.0, 0.0, 0.0)),
            (50.0 - east_m, (0.0, -1.0, 0.0)),
            (50.0 + east_m, (0.0, 1.0, 0.0)),
        )
        return min(walls)


class Airborne:
    """A vehicle hovering on links of its own; ``resident_mb`` is of this process."""

    def __init__(self, *urls, log=None):
        hall = Hall()
        self.world = World(hall, STEADY, 1, hall)
        self.autopilot = self.world.autopilot
        self.links = [open_link(url) for url in urls]
        self.server = MavlinkServer(self.autopilot, self.links, log)
        self._sockets = []
        self.world.advance_to(3.0)
        self.autopilot.arm()
        self.autopilot.take_off(1.5)
        self.fly_until(TAKEN_OFF_S)
        self.start_ned_m = self.world.truth.position_ned_m

    def step(self):
        self.server.poll()
        self.world.step()
        self.server.update(self.world.time_s)

    def fly_until(self, time_s):
        while self.world.time_s < time_s:
            self.step()

    def connect(self, link=0):
        """A client's socket."""
        parts = urlsplit(self.links[link].url)
        tcp = parts.scheme == "tcpin"
        opened = socket.socket(socket.AF_INET, socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM)
        opened.connect((parts.hostname, parts.port))
        opened.setblocking(False)
        self._sockets.append(opened)
        return opened

    def close(self):
        for opened in self._sockets:
            opened.close()
        self.server.close()


@pytest.fixture
def make_airborne():
    """``make_airborne(*urls, log=...)``: one more vehicle in the air."""
    vehicles = deque()

    def make(*urls, **options):
        vehicles.append(Airborne(*urls, **options))
        return vehicles[-1]

    yield make
    for vehicle in vehicles:
        vehicle.close()


@pytest.fixture
def resident_mb():
    """Reads this process's resident memory."""
    page_mb = resource.getpagesize() / 1e6
    path = Path(f"/proc/{os.getpid()}/statm")
    return lambda: int(path.read_text().split()[1]) * page_mb


@pytest.fixture
def codec():
    return development.MAVLink(None, 245, 190)
