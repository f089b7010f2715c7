"""Any bytes on a link: sound messages are found among them, and none stops the vehicle."""

from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from sitl.mavlink.framing import Splitter


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


# One vehicle meets all examples, on purpose: see hostile.
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    frames=st.lists(sound_frames().map(pack) | aimed_frames() | st.binary(max_size=60), max_size=8),
    flips=st.lists(st.tuples(st.integers(0, 400), st.integers(1, 255)), max_size=3),
)
def test_no_bytes_stop_the_vehicle(hostile, frames, flips):
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
    assert any(message.get_type() == "HEARTBEAT" for message in flight.run(1.1))
