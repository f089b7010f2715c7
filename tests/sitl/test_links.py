"""Links of every kind, versions of the protocol, signatures, and what a hostile client may do."""

import hashlib
import os
import pty
import tty
from collections import Counter
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.dialects.v20 import development

from companion.kernel.errors import PlanError, SimulatorError
from sitl.autopilot.interface import Ack
from sitl.cli import spread_links
from sitl.mavlink.framing import Splitter
from sitl.mavlink.link_url import parse_link
from sitl.mavlink.links import UdpLink, open_link
from sitl.mavlink.signing import Keyring, read_key
from sitl.mavlink.streams import STREAMS
from sitl.mavlink.tcp_link import MAX_WAITING_BYTES

ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
KEY = hashlib.sha256(b"a secret").digest()
NOW_UNIX_S = 1_700_000_000.0
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


def signing_codec(key=KEY, unix_s=NOW_UNIX_S):
    codec = development.MAVLink(None, 245, 190)
    codec.signing.secret_key = key
    codec.signing.sign_outgoing = True
    codec.signing.timestamp = round((unix_s - 1_420_070_400) * 1e5)
    return codec


def keyring():
    return Keyring(KEY, lambda: NOW_UNIX_S)


def test_a_signing_client_is_obeyed_and_gets_signed_answers(fly_mavlink):
    flight = fly_mavlink(keyring=keyring(), client={"codec": signing_codec()})
    flight.run(3.0)
    assert flight.acks(ARM, 1.0) == [Ack.ACCEPTED]
    messages = flight.run(1.0)
    assert messages  # its decoder takes only what is signed with the key
    assert all(message.get_signed() for message in messages)


def test_unsigned_commands_are_refused_but_telemetry_may_be_watched(fly_mavlink, caplog):
    flight = fly_mavlink(keyring=keyring())
    assert "ATTITUDE" in kinds(flight.run(3.0))
    assert flight.acks(ARM, 1.0) == []
    assert not flight.autopilot.status.armed
    assert flight.value_of(b"MIS_TAKEOFF_ALT") == []
    (record,) = caplog.records
    assert record.message.startswith("refused COMMAND_LONG: this vehicle obeys signed messages")


@pytest.mark.parametrize(
    "codec",
    [signing_codec(key=bytes(32)), signing_codec(unix_s=NOW_UNIX_S - 90.0)],
    ids=["another key", "more than a minute old"],
)
def test_wrong_and_old_signatures_are_refused(fly_mavlink, codec):
    flight = fly_mavlink(keyring=keyring(), client={"codec": codec})
    flight.run(3.0)
    flight.client.command(ARM, 1.0)
    flight.server.poll()
    assert not flight.autopilot.status.armed


def test_a_recorded_command_cannot_be_replayed(fly_mavlink):
    flight = fly_mavlink(keyring=keyring(), client={"codec": signing_codec()})
    flight.run(3.0)
    codec = signing_codec(unix_s=NOW_UNIX_S + 1.0)
    arm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0).pack(codec)
    disarm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 0, 0, 0, 0, 0, 0, 0).pack(codec)
    for frame, armed in ((arm, True), (disarm, False), (arm, False)):
        flight.client.socket.send(frame)
        flight.server.poll()
        assert flight.autopilot.status.armed is armed


@pytest.mark.parametrize(("content", "works"), [(KEY, True), (KEY.hex().encode(), True), (b"x", 0)])
def test_keys_are_read_from_a_file(tmp_path, content, works):
    path = tmp_path / "key"
    path.write_bytes(content)
    if works:
        assert read_key(path) == KEY
    else:
        with pytest.raises(PlanError, match="a signing key is 32 bytes, or as many in hexadecimal"):
            read_key(path)
    with pytest.raises(PlanError, match="cannot be read: No such file"):
        read_key(tmp_path / "nowhere")


@given(st.data())
def test_sound_frames_are_found_whatever_lies_between_and_wherever_the_stream_is_cut(data):
    codec = mavlink.MAVLink(None, 7, 8)
    frames = [mavlink.MAVLink_system_time_message(0, number).pack(codec) for number in range(5)]
    garbage = st.binary(max_size=20) | st.just(b"\xfd\xff") | st.just(b"\xfe\xff\0\0\0\0")
    stream = b"".join(data.draw(garbage) + frame for frame in frames) + bytes(300)
    splitter, found = Splitter(stream=True), []
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        found += [received.message.time_boot_ms for received in splitter.feed(stream[:cut])]
        stream = stream[cut:]
    assert found == [0, 1, 2, 3, 4]


ANY_MESSAGE = st.sampled_from(sorted(mavlink.mavlink_map))
WORDS = st.lists(st.integers(0, 255) | st.sampled_from([0, 0x7F, 0x80, 0xC0, 0xFF]), max_size=255)


@st.composite
def sound_frames(draw):
    """Frames with a right checksum around any payload at all."""
    kind = mavlink.mavlink_map[draw(ANY_MESSAGE)]
    payload = bytearray(draw(WORDS)[: kind.unpacker.size].copy()).ljust(1, b"\0")
    codec = mavlink.MAVLink(None, 255, 190)
    return SimpleNamespace(id=kind.id, payload=bytes(payload), crc=kind.crc_extra, codec=codec)


@st.composite
def aimed_frames(draw):
    """Messages that the vehicle obeys, with numbers that nobody should send."""
    number = st.floats(width=32) | st.sampled_from([0.0, 1.0, 4.0, 129.0, 21196.0])
    p = draw(st.lists(number, min_size=11, max_size=11))
    n = draw(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=3, max_size=3))
    command = draw(
        st.sampled_from([16, 20, 21, 22, 176, 178, 179, 187, 192, 245, 246, 400, 410])
        | st.sampled_from([510, 511, 512, 519, 520, 521, 2504, 40000])
    )
    name = draw(st.sampled_from([b"MAV_TYPE", b"COM_ARMABLE", b"_HASH_CHECK", b"", b"\xff" * 16]))
    frame = draw(st.integers(0, 21))
    return draw(
        st.sampled_from(
            [
                mavlink.MAVLink_command_long_message(1, 1, command, 0, *p[:7]),
                mavlink.MAVLink_command_int_message(
                    1, 1, frame, command, 0, 0, *p[:4], *n[:2], p[4]
                ),
                mavlink.MAVLink_set_position_target_local_ned_message(
                    0, 1, 1, frame, n[0] & 0xFFF, *p
                ),
                mavlink.MAVLink_param_set_message(1, 1, name, p[0], frame),
                mavlink.MAVLink_param_request_read_message(1, 1, name, n[0] >> 16),
                mavlink.MAVLink_timesync_message(0, n[0]),
            ]
        )
    )


def pack(frame):
    header = bytes((0xFD, len(frame.payload), 0, 0, 0, 255, 190)) + frame.id.to_bytes(3, "little")
    body = header + frame.payload
    return body + mavlink.x25crc(body[1:] + bytes((frame.crc,))).crc.to_bytes(2, "little")


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    frames=st.lists(sound_frames().map(pack) | aimed_frames() | st.binary(max_size=60), max_size=8),
    flips=st.lists(st.tuples(st.integers(0, 400), st.integers(1, 255)), max_size=3),
)
def test_no_bytes_stop_the_vehicle(fly_mavlink, hostile, frames, flips):
    codec = mavlink.MAVLink(None, 255, 190)
    data = bytearray(
        b"".join(f if isinstance(f, bytes) else f.pack(codec) for f in frames) or b"\0"
    )
    for place, bits in flips:
        data[place % len(data)] ^= bits
    hostile.client.socket.send(bytes(data[:2000]))
    for _ in range(3):
        hostile.server.poll()
        hostile.world.step()
        hostile.server.update(hostile.world.time_s)
    hostile.client.received()
    assert all(abs(x) < 1e3 for x in hostile.world.truth.position_ned_m)


@pytest.fixture
def hostile(fly_mavlink):
    """One flight in the air, for all examples: what one leaves behind meets the next."""
    flight = fly_mavlink(client={"kind": mavlink.MAV_TYPE_GCS})
    flight.take_off()
    yield flight
    flight.client = flight.new_client(0)
    assert "HEARTBEAT" in kinds(flight.run(1.1))
