"""Uploads and downloads over links that lose, double and reorder messages."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.messages import FlightMode
from sitl.autopilot.geofence import Circle, Polygon
from sitl.autopilot.home import Home
from sitl.autopilot.interface import Estimate
from sitl.autopilot.mission import Jump, TakeOffTo, Waypoint
from sitl.autopilot.parameters import default_parameters
from sitl.autopilot.plans import Plans
from sitl.mavlink import commands
from sitl.mavlink.missions import MissionProtocol
from sitl.mavlink.places import Earth, Origin

ORIGIN = Origin()
MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255
RELATIVE, LOCAL, NO_PLACE = 6, 1, 2
ACCEPTED = mavlink.MAV_MISSION_ACCEPTED


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
        self.protocol = MissionProtocol(self.board, Earth(ORIGIN, self.board.plans.home))
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


def item(number, command, frame, params=(0, 0, 0, math.nan), place=(0, 0, 0), kind=MISSION):
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, number, frame, command, 0, 1, *map(float, params), *place[:2], float(place[2]), kind
    )


def waypoint(number, north_m=1.0, east_m=0.5, kind=MISSION, command=16, params=(0, 0, 0, math.nan)):
    place = (round(north_m * 1e4), round(east_m * 1e4), -1.5)
    return item(number, command, LOCAL, params, place, kind)


@pytest.fixture
def station():
    return Station()


def test_what_was_uploaded_comes_back_unchanged(station):
    items = [waypoint(n, n * 0.1) for n in range(5)]
    assert station.upload(items) == ACCEPTED
    back = [m.to_dict() for m in station.download()]
    assert [entry.pop("current") for entry in back] == [1, 0, 0, 0, 0]
    for entry, sent in zip(back, items, strict=True):
        wanted = {key: value for key, value in sent.to_dict().items() if key in entry}
        assert repr(wanted) == repr({**entry, "target_system": 1, "target_component": 1})
    assert len(station.board.plans.mission.items) == 5
    assert station.board.plans.mission.items[3].position_ned_m == pytest.approx((0.3, 0.5, -1.5))


def test_frames_are_turned_into_local_places(station):
    east = 100.0 / (111_319.5 * math.cos(math.radians(ORIGIN.latitude_deg)))
    place = (round(ORIGIN.latitude_deg * 1e7), round((ORIGIN.longitude_deg + east) * 1e7))
    items = [
        item(0, 22, RELATIVE, (0, 0, 0, 90), (0, 0, 2)),
        item(1, 16, RELATIVE, (3, 0.7, 0, math.nan), (*place, 3)),
        item(2, 16, 0, (0, 0, 0, 0), (*place, ORIGIN.amsl_m + 4)),
        item(3, 177, NO_PLACE, (1, 2, 0, 0)),
    ]
    assert station.upload(items) == ACCEPTED
    up, relative, amsl, jump = station.board.plans.mission.items
    assert isinstance(up, TakeOffTo)
    assert math.isnan(up.position_ned_m[0])
    assert (up.position_ned_m[2], up.yaw_rad) == (-2.0, pytest.approx(math.pi / 2))
    assert relative.position_ned_m == pytest.approx((0.0, 100.0, -3.0), abs=0.02)
    assert (relative.hold_s, relative.acceptance_m) == (3.0, pytest.approx(0.7))
    assert amsl.position_ned_m[2] == -4.0
    assert jump == Jump(1, 2.0)


def test_older_clients_send_and_get_floats(station):
    old = mavlink.MAVLink_mission_item_message(
        *(1, 1, 0, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, ORIGIN.latitude_deg, ORIGIN.longitude_deg, 2.0)
    )
    assert station.upload([old]) == ACCEPTED
    station.send(mavlink.MAVLink_mission_request_message(1, 1, 0))
    (answer,) = station.take()
    assert answer.get_type() == "MISSION_ITEM"
    assert (answer.x, answer.y) == pytest.approx(
        (ORIGIN.latitude_deg, ORIGIN.longitude_deg), abs=1e-5
    )


@pytest.mark.parametrize(
    ("second", "result", "text"),
    [
        (item(1, 3000, NO_PLACE), mavlink.MAV_MISSION_UNSUPPORTED, "MAV_CMD 3000 unknown"),
        (item(1, 16, 10), mavlink.MAV_MISSION_UNSUPPORTED_FRAME, "MAV_FRAME 10"),
        (item(1, 16, 6), mavlink.MAV_MISSION_INVALID_PARAM5_X, "names no place"),
        (item(1, 93, 2, (-1, 0, 0, 0)), mavlink.MAV_MISSION_INVALID_PARAM1, "param1 is -1"),
        (item(1, 177, 2, (0, math.nan, 0, 0)), mavlink.MAV_MISSION_INVALID_PARAM2, "param2 is nan"),
        (
            item(1, 16, 1, place=(1, 1, math.inf)),
            mavlink.MAV_MISSION_INVALID_PARAM7,
            "height not finite",
        ),
        (item(1, 177, 2, (9, 1, 0, 0)), mavlink.MAV_MISSION_INVALID, "no item to jump to: 9"),
        (waypoint(1, 20_000.0), mavlink.MAV_MISSION_INVALID, "first place is 20000 m away"),
    ],
)
def test_a_rejected_plan_says_which_item_and_why(station, second, result, text):
    assert station.upload([waypoint(0)]) == ACCEPTED
    first = item(0, 22, RELATIVE, place=(0, 0, 1))
    assert station.upload([first, second]) == result
    assert station.board.texts == [f"Item 1 rejected: {text}"]
    assert len(station.board.texts[0]) <= 50  # a STATUSTEXT's length
    assert len(station.board.plans.mission.items) == 1  # the plan before stays
    assert len(station.download()) == 1


def corner(number, north_m, east_m, count=3, command=5001):
    return waypoint(number, north_m, east_m, FENCE, command, (count, 0, 0, 0))


def test_fences_are_made_of_circles_and_polygons(station):
    items = [
        *(corner(n, *place) for n, place in enumerate([(0, 0), (0, 1), (1, 0)])),
        waypoint(3, 2.0, 0.0, FENCE, 5004, (0.5, 0, 0, 0)),
    ]
    assert station.upload(items, FENCE) == ACCEPTED
    assert station.board.plans.fence == (
        Polygon(((0.0, 0.0), (0.0, 1.0), (1.0, 0.0)), True),
        Circle((2.0, 0.0), 0.5, False),
    )
    assert len(station.download(FENCE)) == 4
    lacking = [corner(0, 0, 0, 4), corner(1, 0, 1, 4), corner(2, 1, 0, 4)]
    assert station.upload(lacking, FENCE) == mavlink.MAV_MISSION_INVALID_PARAM1
    assert station.board.texts == ["Item 0 rejected: polygon lacks some of 4 vertices"]
    assert len(station.board.plans.fence) == 2


def test_rally_points_and_clearing(station):
    assert station.upload([waypoint(0)]) == ACCEPTED
    assert station.upload([waypoint(0, 3.0, 0.0, RALLY, 5100)], RALLY) == ACCEPTED
    assert station.board.plans.rally_ned_m == ((3.0, 0.0, 0.0),)
    station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, ALL))
    assert [m.type for m in station.take()] == [ACCEPTED]
    assert station.board.plans.rally_ned_m == ()
    assert station.board.plans.mission.items == ()
    assert station.download() == []


def test_an_item_that_stays_away_is_asked_for_again_until_it_is_given_up(station):
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 2))
    station.wait(4.9)
    asked = station.take()
    assert [m.seq for m in asked] == [0] * len(asked)
    assert 18 <= len(asked) <= 21
    station.wait(0.2)
    assert [m.type for m in station.take()] == [mavlink.MAV_MISSION_OPERATION_CANCELLED]
    assert station.board.texts == ["Upload timed out"]
    assert station.upload([waypoint(0)]) == ACCEPTED


def test_one_client_uploads_at_a_time(station):
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 2))
    station.take()
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 1), system=7)
    assert [m.type for m in station.take()] == [mavlink.MAV_MISSION_DENIED]
    station.send(waypoint(0), system=7)
    assert station.take() == []
    station.send(waypoint(0))
    assert [m.seq for m in station.take()] == [1]
    station.send(mavlink.MAVLink_mission_ack_message(1, 1, 15))
    assert station.upload([waypoint(0)]) == ACCEPTED


def test_what_cannot_be_asked_for_is_refused(station):
    station.send(mavlink.MAVLink_mission_request_int_message(1, 1, 5))
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 5000))
    station.send(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 0, 1))
    station.send(mavlink.MAVLink_mission_request_list_message(1, 1, mission_type=77))
    assert [m.type for m in station.take()] == [
        mavlink.MAV_MISSION_INVALID_SEQUENCE,
        mavlink.MAV_MISSION_NO_SPACE,
        mavlink.MAV_MISSION_UNSUPPORTED,
        mavlink.MAV_MISSION_UNSUPPORTED,
    ]


def test_the_current_item_is_set_and_told(station):
    station.upload([waypoint(0), waypoint(1)])
    station.protocol.update()
    station.send(mavlink.MAVLink_mission_set_current_message(1, 1, 1))
    assert [(m.seq, m.total) for m in station.take()] == [(1, 2)]
    station.board.plans.mission.finish_item()
    station.board.time_s += 0.05
    news = station.protocol.update()
    assert [m.get_type() for m in news] == ["MISSION_ITEM_REACHED", "MISSION_CURRENT"]
    assert (news[0].seq, news[1].mission_state) == (1, 5)
    assert station.protocol.update() == []
    station.send(mavlink.MAVLink_mission_set_current_message(1, 1, 9))
    assert station.board.texts == ["No mission item 9"]


fates = st.lists(st.sampled_from(["pass", "pass", "pass", "lose", "double", "late"]), max_size=60)


@settings(max_examples=60)
@given(there=fates, back=fates, count=st.integers(1, 6))
def test_an_upload_over_a_bad_link_is_whole_or_not_at_all(there, back, count):
    """A client as MAVLink describes it: it answers requests, and repeats its count or last item."""
    station = Station()
    station.upload([waypoint(0, 9.0)])
    wanted = [waypoint(n, 0.1 * n) for n in range(count)]
    to_vehicle, to_client = Road(there), Road(back)
    newest = mavlink.MAVLink_mission_count_message(1, 1, count)
    outgoing, result = [newest], None
    for _ in range(80):
        for message in to_vehicle.carry(outgoing):
            station.send(message)
        outgoing = []
        for answer in to_client.carry(station.take()):
            if answer.get_type() == "MISSION_ACK":
                result = answer.type
            else:
                newest = wanted[answer.seq]
                outgoing.append(newest)
        if result is not None:
            break
        station.wait(0.1)
        outgoing = outgoing or [newest]
    stored = [m.x for m in station.download()]
    assert stored in ([m.x for m in wanted], [90_000])
    if result == ACCEPTED:
        assert stored == [m.x for m in wanted]
        assert len(station.board.plans.mission.items) == count


class Road:
    """Carries messages; each next fate is for one of them, and after the last all pass."""

    def __init__(self, fates):
        self._fates = list(fates)
        self._late = []

    def carry(self, messages):
        arriving, late = [], []
        for message in messages:
            fate = self._fates.pop(0) if self._fates else "pass"
            arriving += [message] * {"lose": 0, "late": 0, "double": 2}.get(fate, 1)
            if fate == "late":
                late.append(message)
        arriving += self._late
        self._late = late
        return arriving


messages = st.one_of(
    st.builds(
        item,
        st.integers(0, 5),
        st.sampled_from([16, 19, 20, 21, 22, 93, 115, 177, 178, 5001, 5003, 5100, 9999]),
        st.integers(0, 21),
        st.tuples(*[st.floats(width=32)] * 4),
        st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 2, st.floats(width=32)),
        st.sampled_from([0, 1, 2, 7, 255]),
    ),
    st.builds(
        mavlink.MAVLink_mission_count_message,
        *(st.just(1), st.just(1), st.integers(0, 6), st.sampled_from([0, 1, 2, 7, 255])),
    ),
    st.builds(
        mavlink.MAVLink_mission_request_int_message,
        *(st.just(1), st.just(1), st.integers(0, 9), st.sampled_from([0, 1, 2, 7, 255])),
    ),
    st.builds(
        mavlink.MAVLink_mission_item_message,
        *(st.just(1), st.just(1), st.integers(0, 5), st.integers(0, 21)),
        *(st.sampled_from([16, 22, 177]), st.just(0), st.integers(0, 1)),
        *[st.floats(width=32)] * 7,
    ),
    st.builds(mavlink.MAVLink_mission_set_current_message, *[st.integers(0, 9)] * 3),
    st.builds(mavlink.MAVLink_mission_clear_all_message, *[st.integers(0, 2)] * 3),
)


@settings(max_examples=150)
@given(st.lists(messages, max_size=25))
def test_any_conversation_is_survived(conversation):
    station = Station()
    for message in conversation:
        station.send(message)
        station.wait(0.1)
        plans = station.board.plans
        assert plans.problem(plans.mission.items) is None
        assert plans.mission.current < max(1, len(plans.mission.items))


def test_commands_start_a_mission_and_choose_its_item(make_flight):
    flight = make_flight()
    flight.get_ready()
    start, choose = mavlink.MAV_CMD_MISSION_START, mavlink.MAV_CMD_DO_SET_MISSION_CURRENT
    nothing = (math.nan,) * 7
    assert commands.execute(flight.autopilot, start, nothing) == 1  # there is none
    assert commands.execute(flight.autopilot, choose, (1.0, *nothing[1:])) == 2
    flight.autopilot.plans.mission.load([Waypoint((0.0, 0.0, -1.0)), Waypoint((1.0, 0.0, -1.0))])
    assert commands.execute(flight.autopilot, choose, (1.0, *nothing[1:])) == 0
    assert commands.execute(flight.autopilot, start, nothing) == 0
    assert flight.status.armed
    assert flight.status.mode is FlightMode.MISSION
    assert flight.status.mission.current == 1
