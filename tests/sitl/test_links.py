"""Links of every kind, several clients at once, and both versions of the protocol."""

import os
import pty
import tty
from collections import Counter

import pytest
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.dialects.v20 import development

from companion.kernel.errors import PlanError, SimulatorError
from sitl.autopilot.interface import Ack
from sitl.cli import spread_links
from sitl.mavlink.link_url import parse_link
from sitl.mavlink.links import UdpLink, open_link
from sitl.mavlink.streams import STREAMS
from sitl.mavlink.tcp_link import MAX_WAITING_BYTES

ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
ANY_TCP = "tcpin://127.0.0.1:0"
ANY_UDP = "udpin://127.0.0.1:0"


def kinds(messages):
    return {message.get_type() for message in messages}


def test_two_tcp_clients_fly_the_same_vehicle(fly_mavlink):
    flight = fly_mavlink(ANY_TCP)
    other = flight.new_client(0, kind=mavlink.MAV_TYPE_GCS)
    flight.run(3.0)
    assert flight.acks(ARM, 1.0) == [Ack.ACCEPTED]
    flight.client.close()
    flight.client = other
    messages = flight.run(0.5)
    assert "ATTITUDE" in kinds(messages)
    texts = {message.text for message in messages if message.get_type() == "STATUSTEXT"}
    assert "Armed by external command" in texts


def test_a_frame_may_come_in_pieces_over_tcp(fly_mavlink):
    flight = fly_mavlink(ANY_TCP)
    message = mavlink.MAVLink_command_long_message(1, 1, REQUEST, 0, 148, 0, 0, 0, 0, 0, 0)
    frame = message.pack(mavlink.MAVLink(None, 245, 190))
    for byte in frame:
        flight.client.socket.send(bytes((byte,)))
        flight.server.poll()
    assert flight.answers("AUTOPILOT_VERSION")


def test_a_tcp_client_that_does_not_read_harms_nobody(fly_mavlink):
    flight = fly_mavlink(ANY_TCP)
    deaf = flight.new_client(0)
    flight.run(0.1)
    block = bytes(1400)
    for _ in range(3 * MAX_WAITING_BYTES // len(block)):
        for client in flight.links[0].clients:
            client.send(block)
        flight.client.socket.recv(65536)
    assert all(len(client._waiting) <= MAX_WAITING_BYTES for client in flight.links[0].clients)
    deaf.close()
    flight.run(0.5)


def test_a_client_that_goes_is_forgotten(fly_mavlink):
    flight = fly_mavlink(ANY_TCP)
    for _ in range(40):
        flight.new_client(0).close()
        flight.run(0.02)
    assert len(flight.server.channels) == 1
    assert flight.acks(REQUEST, mavlink.MAVLINK_MSG_ID_ATTITUDE) == [Ack.ACCEPTED]


def heard_on(descriptor, codec):
    messages = []
    while True:
        try:
            messages += codec.parse_buffer(os.read(descriptor, 4096)) or []
        except BlockingIOError:
            return messages


def test_a_serial_line_carries_mavlink_both_ways(fly_mavlink):
    far, near = pty.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    codec = development.MAVLink(None, 245, 190)
    try:
        flight = fly_mavlink(ANY_UDP, f"serial://{os.ttyname(near)}:57600")
        flight.run(0.1)
        assert "HEARTBEAT" in kinds(heard_on(far, codec))  # spoken to from the start
        command = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 7, 0, 0, 0, 0, 0, 0)
        os.write(far, command.pack(codec))
        flight.server.poll()
        heard = heard_on(far, codec)
        assert [m.result for m in heard if m.get_type() == "COMMAND_ACK"] == [Ack.DENIED]
    finally:
        os.close(far)
        os.close(near)
    flight.run(0.1)  # nobody holds the far end any more


def test_a_serial_line_that_cannot_be_opened_is_one_clear_error(tmp_path):
    with pytest.raises(SimulatorError, match=r"^serial:///dev/nowhere: cannot be opened: No such"):
        open_link("serial:///dev/nowhere")
    (tmp_path / "file").touch()
    with pytest.raises(SimulatorError, match="not a serial line"):
        open_link(f"serial://{tmp_path}/file:57600")
    with pytest.raises(PlanError, match="12345 is not a baud rate"):
        open_link("serial:///dev/ttyS0:12345")


def test_a_busy_tcp_port_is_one_clear_error():
    first = open_link(ANY_TCP)
    with pytest.raises(SimulatorError, match=r"^tcpin://.*: cannot use local port .* in use$"):
        open_link(first.url)
    first.close()


def test_links_listen_on_this_machine_alone_unless_another_address_is_named():
    assert [parse_link(f"{kind}://:5760").host for kind in ("udpin", "tcpin")] == ["127.0.0.1"] * 2
    assert parse_link("tcpin://0.0.0.0:5760").host == "0.0.0.0"
    link = UdpLink("udpout://127.0.0.1:9")
    assert link.socket.getsockname()[0] == "127.0.0.1"
    link.close()


def test_several_links_may_follow_one_option():
    one = spread_links(["run", "room", "--mavlink", "udpin://:1", "tcpin://:2", "--speed", "2"])
    many = ["run", "room", "--mavlink", "udpin://:1", "--mavlink", "tcpin://:2", "--speed", "2"]
    assert one == many == spread_links(many)


def test_a_listening_link_only_beats_until_its_client_does(fly_mavlink):
    flight = fly_mavlink(client={"kind": None})
    assert flight.run(1.0) == []
    assert flight.acks(REQUEST, 9999.0) == [Ack.DENIED]
    assert kinds(flight.run(1.0)) <= {"HEARTBEAT"}
    flight.client.beat()
    assert {"ATTITUDE", "HEARTBEAT"} <= kinds(flight.run(1.0))


def test_a_ground_stations_link_has_px4s_rates_for_it(fly_mavlink):
    flight = fly_mavlink(f"{ANY_UDP}?profile=gcs")
    counts = Counter(message.get_msgId() for message in flight.run(20.0))
    for message_id, stream in STREAMS.items():
        in_orbit_only = message_id == mavlink.MAVLINK_MSG_ID_ORBIT_EXECUTION_STATUS
        expected = 0.0 if in_orbit_only else stream.gcs_hz * 20.0
        assert counts[message_id] == pytest.approx(expected, abs=1.0, rel=0.05), message_id


def test_two_clients_of_one_link_have_their_own_rates(fly_mavlink):
    flight = fly_mavlink()
    twin = flight.new_client(0)
    flight.run(0.1)
    attitude = mavlink.MAVLINK_MSG_ID_ATTITUDE
    flight.acks(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, 1e5)
    twin.received()
    mine = Counter(message.get_type() for message in flight.run(1.0))
    assert mine["ATTITUDE"] == pytest.approx(10, abs=1)
    theirs = Counter(message.get_type() for message in twin.received())
    assert theirs["ATTITUDE"] == pytest.approx(100, abs=2)


def test_many_clients_are_a_limit_not_a_failure(fly_mavlink):
    flight = fly_mavlink()
    for _ in range(40):
        flight.new_client(0)
    flight.run(0.1)
    assert len(flight.links[0].clients) == 16
    assert flight.acks(REQUEST, 9999.0) == [Ack.DENIED]


def test_a_client_of_mavlink_1_is_answered_in_mavlink_1(fly_mavlink):
    flight = fly_mavlink(client={"version": 1})
    flight.run(0.1)
    messages = flight.run(2.0)
    assert {message.get_msgbuf()[0] for message in messages} == {mavlink.PROTOCOL_MARKER_V1}
    assert {"HEARTBEAT", "ATTITUDE", "HOME_POSITION"} <= kinds(messages)
    assert not {"ODOMETRY", "CURRENT_MODE"} & kinds(messages)  # MAVLink 1 has no such numbers
    position = next(m for m in messages if m.get_type() == "HOME_POSITION")
    assert len(position.get_payload()) == 52  # no extension fields
    assert flight.acks(ARM, 7.0) == [Ack.DENIED]
    assert flight.value_of(b"MIS_TAKEOFF_ALT") == [2.5]


def test_the_version_can_be_fixed(fly_mavlink):
    flight = fly_mavlink()
    flight.autopilot.set_parameter("MAV_PROTO_VER", 1)
    assert {m.get_msgbuf()[0] for m in flight.run(1.0)} == {mavlink.PROTOCOL_MARKER_V1}
