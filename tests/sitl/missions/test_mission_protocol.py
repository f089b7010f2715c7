"""Uploads and downloads of missions, fences and rally points, and what is refused."""

import math

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.messages import FlightMode
from sitl.autopilot.geofence import Circle, Polygon
from sitl.autopilot.mission import Jump, TakeOffTo, Waypoint
from sitl.mavlink import commands
from sitl.mavlink.places import Origin

ORIGIN = Origin()
FENCE, RALLY, ALL = 1, 2, 255
RELATIVE, LOCAL, NO_PLACE = 6, 1, 2
UNTURNED = 0, 0, 0, math.nan
ACCEPTED = mavlink.MAV_MISSION_ACCEPTED


def test_what_was_uploaded_comes_back_unchanged(station, waypoint):
    items = [waypoint(n, n * 0.1) for n in range(5)]
    assert station.upload(items) == ACCEPTED
    back = [m.to_dict() for m in station.download()]
    assert [entry.pop("current") for entry in back] == [1, 0, 0, 0, 0]
    for entry, sent in zip(back, items, strict=True):
        wanted = {key: value for key, value in sent.to_dict().items() if key in entry}
        assert repr(wanted) == repr({**entry, "target_system": 1, "target_component": 1})
    assert len(station.board.plans.mission.items) == 5
    assert station.board.plans.mission.items[3].position_ned_m == pytest.approx((0.3, 0.5, -1.5))


def test_frames_are_turned_into_local_places(station, item):
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
        ((3000, NO_PLACE), mavlink.MAV_MISSION_UNSUPPORTED, "MAV_CMD 3000 unknown"),
        ((16, 10), mavlink.MAV_MISSION_UNSUPPORTED_FRAME, "MAV_FRAME 10"),
        ((16, 6), mavlink.MAV_MISSION_INVALID_PARAM5_X, "names no place"),
        ((93, 2, (-1, 0, 0, 0)), mavlink.MAV_MISSION_INVALID_PARAM1, "param1 is -1"),
        ((177, 2, (0, math.nan, 0, 0)), mavlink.MAV_MISSION_INVALID_PARAM2, "param2 is nan"),
        (
            (16, LOCAL, UNTURNED, (1, 1, math.inf)),
            mavlink.MAV_MISSION_INVALID_PARAM7,
            "height not finite",
        ),
        ((177, 2, (9, 1, 0, 0)), mavlink.MAV_MISSION_INVALID, "no item to jump to: 9"),
        (
            (16, LOCAL, UNTURNED, (200_000_000, 5_000, -1.5)),
            mavlink.MAV_MISSION_INVALID,
            "first place is 20000 m away",
        ),
    ],
)
def test_a_rejected_plan_says_which_item_and_why(station, item, waypoint, second, result, text):
    assert station.upload([waypoint(0)]) == ACCEPTED
    first = item(0, 22, RELATIVE, place=(0, 0, 1))
    assert station.upload([first, item(1, *second)]) == result
    assert station.board.texts == [f"Item 1 rejected: {text}"]
    assert len(station.board.texts[0]) <= 50  # a STATUSTEXT's length
    assert len(station.board.plans.mission.items) == 1  # the plan before stays
    assert len(station.download()) == 1


def test_fences_are_made_of_circles_and_polygons(station, waypoint):
    def corner(number, north_m, east_m, count=3):
        return waypoint(number, north_m, east_m, FENCE, 5001, (count, 0, 0, 0))

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


def test_rally_points_and_clearing(station, waypoint):
    assert station.upload([waypoint(0)]) == ACCEPTED
    assert station.upload([waypoint(0, 3.0, 0.0, RALLY, 5100)], RALLY) == ACCEPTED
    assert station.board.plans.rally_ned_m == ((3.0, 0.0, 0.0),)
    station.send(mavlink.MAVLink_mission_clear_all_message(1, 1, ALL))
    assert [m.type for m in station.take()] == [ACCEPTED]
    assert station.board.plans.rally_ned_m == ()
    assert station.board.plans.mission.items == ()
    assert station.download() == []


def test_an_item_that_stays_away_is_asked_for_again_until_it_is_given_up(station, waypoint):
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 2))
    station.wait(4.9)
    asked = station.take()
    assert [m.seq for m in asked] == [0] * len(asked)
    assert 18 <= len(asked) <= 21
    station.wait(0.2)
    assert [m.type for m in station.take()] == [mavlink.MAV_MISSION_OPERATION_CANCELLED]
    assert station.board.texts == ["Upload timed out"]
    assert station.upload([waypoint(0)]) == ACCEPTED


def test_one_client_uploads_at_a_time(station, waypoint):
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


def test_the_current_item_is_set_and_told(station, waypoint):
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
