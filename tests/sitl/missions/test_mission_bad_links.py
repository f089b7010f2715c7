"""Missions over links that lose, double and reorder, and from clients that make no sense."""

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

ACCEPTED = mavlink.MAV_MISSION_ACCEPTED
fates = st.lists(st.sampled_from(["pass", "pass", "pass", "lose", "double", "late"]), max_size=60)


@settings(max_examples=60)
@given(there=fates, back=fates, count=st.integers(1, 6))
def test_an_upload_is_whole_or_not_at_all(make_station, waypoint, there, back, count):
    """A client as MAVLink describes it: it answers requests, and repeats its count or last item."""
    station = make_station()
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
        mavlink.MAVLink_mission_item_int_message,
        *(st.just(1), st.just(1), st.integers(0, 5), st.integers(0, 21)),
        st.sampled_from([16, 19, 20, 21, 22, 93, 115, 177, 178, 5001, 5003, 5100, 9999]),
        *(st.just(0), st.just(1)),
        *[st.floats(width=32)] * 4,
        *[st.integers(-(2**31), 2**31 - 1)] * 2,
        *(st.floats(width=32), st.sampled_from([0, 1, 2, 7, 255])),
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
def test_any_conversation_is_survived(make_station, conversation):
    station = make_station()
    for message in conversation:
        station.send(message)
        station.wait(0.1)
        plans = station.board.plans
        assert plans.problem(plans.mission.items) is None
        assert plans.mission.current < max(1, len(plans.mission.items))
