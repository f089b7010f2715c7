"""A vehicle's memory for missions, and a client that fills it."""

import math

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.home import Home
from sitl.autopilot.interface import Estimate
from sitl.autopilot.parameters import default_parameters
from sitl.autopilot.plans import Plans
from sitl.mavlink.missions import MissionProtocol
from sitl.mavlink.places import Earth, Origin

MISSION = mavlink.MAV_MISSION_TYPE_MISSION
UNTURNED = 0, 0, 0, math.nan


class Board:
    """The part of the autopilot that the protocol needs."""

    def __init__(self):
        self.plans = Plans(default_parameters(), Home(0.0))
        self.texts = []
        self.time_s = 0.0

    @property
    def estimate(self):
        nothing = (0.0, 0.0, 0.0)
        return Estimate(self.time_s, nothing, nothing, 0.0, 0.0, 0.0, nothing, nothing)

    @property
    def status(self):
        return type("Status", (), {"mission": self.plans.mission.progress(False)})

    def announce(self, severity, text):
        self.texts.append(text)


class Station:
    """A client; ``answers`` collects what came back."""

    def __init__(self, board=None, system=255):
        self.board = board or Board()
        self.protocol = MissionProtocol(self.board, Earth(Origin(), self.board.plans.home))
        self.system = system
        self.answers = []

    def send(self, message, system=None):
        codec = mavlink.MAVLink(None, system or self.system, 190)
        received = mavlink.MAVLink(None).decode(bytearray(message.pack(codec)))
        self.protocol.handlers[received.get_msgId()](received, self.answers.append)

    def take(self):
        answers = list(self.answers)
        self.answers.clear()
        return answers

    def wait(self, duration_s):
        for _ in range(round(duration_s / 0.05)):
            self.board.time_s += 0.05
            self.protocol.update()

    def upload(self, items, kind=MISSION):
        """The result of an upload without losses."""
        self.take()
        self.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), mission_type=kind))
        while True:
            (answer,) = self.take()
            if answer.get_type() == "MISSION_ACK":
                return answer.type
            self.send(items[answer.seq])

    def download(self, kind=MISSION):
        self.send(mavlink.MAVLink_mission_request_list_message(1, 1, mission_type=kind))
        (count,) = self.take()
        for number in range(count.count):
            self.send(mavlink.MAVLink_mission_request_int_message(1, 1, number, mission_type=kind))
        return self.take()


def make_item(number, command, frame, params=UNTURNED, place=(0, 0, 0), kind=MISSION):
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, number, frame, command, 0, 1, *map(float, params), *place[:2], float(place[2]), kind
    )


def make_waypoint(number, north_m=1.0, east_m=0.5, kind=MISSION, command=16, params=UNTURNED):
    place = (round(north_m * 1e4), round(east_m * 1e4), -1.5)
    return make_item(number, command, mavlink.MAV_FRAME_LOCAL_NED, params, place, kind)


@pytest.fixture(scope="session")
def item():
    """``item(number, command, frame, params, place, kind)``: as it is sent."""
    return make_item


@pytest.fixture(scope="session")
def waypoint():
    """``waypoint(number, north_m, east_m, ...)``: an item in local metres."""
    return make_waypoint


@pytest.fixture(scope="session")
def make_station():
    return Station


@pytest.fixture
def station():
    return Station()
