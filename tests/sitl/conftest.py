"""A vehicle in a hall without obstacles, for tests of the autopilot and the world."""

import functools
import math
import socket
from typing import NamedTuple
from urllib.parse import urlsplit

import pytest
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.dialects.v20 import development

from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Ack, OffboardSetpoint
from sitl.mavlink.camera import CameraDescription
from sitl.mavlink.links import open_link
from sitl.mavlink.server import MavlinkServer
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


@pytest.fixture(scope="session")
def make_flight():
    """Builds a flight: ``make_flight(hall=..., settings=..., seed=...)``."""
    return FlightCard


@pytest.fixture(scope="session")
def make_hall():
    return Hall


@pytest.fixture
def flight():
    return FlightCard()


@pytest.fixture
def airborne(flight):
    flight.take_off()
    return flight


VELOCITY_AND_YAW_RATE = 1479
"""The mask that MAVSDK sends."""


class OpenAir:
    """A room without walls."""

    start_position_ned_m = (0.0, 0.0, 0.0)
    start_yaw_rad = 0.5

    def nearest(self, position_ned_m):
        return 100.0, (1.0, 0.0, 0.0)


class MavlinkClient:
    """A companion computer on its own socket."""

    def __init__(self, link, kind=mavlink.MAV_TYPE_ONBOARD_CONTROLLER, version=2, codec=None):
        """``kind`` None says nothing; a ``codec`` of ``development`` may sign."""
        parts = urlsplit(link.url)
        tcp = parts.scheme == "tcpin"
        self.socket = socket.socket(
            socket.AF_INET, socket.SOCK_STREAM if tcp else socket.SOCK_DGRAM
        )
        self.socket.connect((parts.hostname, parts.port))
        self.socket.setblocking(False)
        self._codec = codec or development.MAVLink(None, 245, 190)
        self._version = version
        if kind is not None:
            self.beat(kind)

    def beat(self, kind=mavlink.MAV_TYPE_ONBOARD_CONTROLLER):
        self.send(mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3))

    def send(self, message):
        self.socket.send(message.pack(self._codec, force_mavlink1=self._version == 1))
        self._codec.seq = (self._codec.seq + 1) % 256

    def command(self, command, *parameters):
        parameters = (*parameters, *(math.nan,) * (7 - len(parameters)))
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, 0, *parameters))

    def received(self):
        messages = []
        while True:
            try:
                data = self.socket.recv(4096)
            except (BlockingIOError, ConnectionError):
                return messages
            if not data:
                return messages
            messages += self._codec.parse_buffer(data) or []

    def close(self):
        self.socket.close()


class MavlinkFlight:
    """A world, its server on links of its own, and a client on the first."""

    def __init__(self, urls, settings=None, client=None, **server):
        room = OpenAir()
        self.world = World(room, settings or SitlSettings(), 1, room)
        self.autopilot = self.world.autopilot
        self.links = [open_link(url) for url in urls]
        self.server = MavlinkServer(self.autopilot, self.links, **server)
        self._clients = []
        self.client = self.new_client(0, **(client or {}))
        self.server.poll()

    def new_client(self, link, **options):
        self._clients.append(MavlinkClient(self.links[link], **options))
        return self._clients[-1]

    def run(self, duration_s):
        """Returns what the client got meanwhile."""
        return list(self.each(duration_s))

    def each(self, duration_s):
        """The same one by one, as they come."""
        end_s = self.world.time_s + duration_s
        while self.world.time_s < end_s - 1e-9:
            self.server.poll()
            self.world.step()
            self.server.update(self.world.time_s)
            yield from self.client.received()

    def interval_us(self, number):
        self.client.received()
        self.client.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, number)
        (answer,) = self.answers("MESSAGE_INTERVAL")
        assert answer.message_id == number
        return answer.interval_us

    def answers(self, kind):
        self.server.poll()
        return [m for m in self.client.received() if m.get_type() == kind]

    def acks(self, command, *parameters):
        self.client.received()
        self.client.command(command, *parameters)
        return [Ack(m.result) for m in self.answers("COMMAND_ACK") if m.command == command]

    def take_off(self):
        self.run(3.0)
        assert self.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == [Ack.ACCEPTED]
        assert self.acks(mavlink.MAV_CMD_NAV_TAKEOFF) == [Ack.ACCEPTED]
        self.run(12.0)

    def send_setpoint(self, velocity, yaw_rate=0.0, frame=mavlink.MAV_FRAME_BODY_NED):
        self.client.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                *(0, 1, 1, frame, VELOCITY_AND_YAW_RATE),
                *(0.0, 0.0, 0.0, *velocity, 0.0, 0.0, 0.0, 0.0, yaw_rate),
            )
        )

    def value_of(self, name):
        self.client.send(mavlink.MAVLink_param_request_read_message(1, 1, name, -1))
        return [m.param_value for m in self.answers("PARAM_VALUE")]

    def close(self):
        for client in self._clients:
            client.close()
        self.server.close()


def _flights():
    flights = []

    def fly(*urls, **options):
        flights.append(MavlinkFlight(urls or ("udpin://127.0.0.1:0",) * 2, **options))
        return flights[-1]

    yield fly
    for flight in flights:
        flight.close()


@pytest.fixture
def fly_mavlink():
    """Builds flights with clients: ``fly_mavlink(*urls, settings=..., client={...}, log=...)``."""
    yield from _flights()


@pytest.fixture(scope="module")
def make_module_flight(camera_description):
    """One flight for all tests of a module, on the ground: the same at every call."""
    for fly in _flights():
        yield functools.cache(lambda fly=fly: fly(camera=camera_description))


@pytest.fixture(scope="session")
def camera_description():
    eye = Intrinsics(focal_x_px=100.0, focal_y_px=100.0, centre_x_px=63.5, centre_y_px=47.5)
    calibration = StereoCalibration(
        width_px=128, height_px=96, left=eye, right=eye, baseline_m=0.06
    )
    return CameraDescription(calibration, 10.0, "tcp://127.0.0.1:14590")
