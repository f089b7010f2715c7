"""Bytes that are no MAVLink, and more clients than there should be: the vehicle stays there."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.messages import FlightMode
from sitl.mavlink.udp_link import MAX_CLIENTS

BLOCK_BYTES = 1000
GROWTH_LIMIT_MB = 20.0


def blocks(codec, total_bytes, rng):
    """Noise, frames with flipped bits, frames cut and glued: none of them sound."""
    arm = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 0, 21196, 0, 0, 0, 0, 0)
    terminate = mavlink.MAVLink_command_long_message(1, 1, 185, 0, 1, 0, 0, 0, 0, 0, 0)
    sound = b"".join(message.pack(codec) for message in (arm, terminate)) * 12
    sent = 0
    while sent < total_bytes:
        block = bytearray(rng.bytes(BLOCK_BYTES) if rng.random() < 0.5 else sound[:BLOCK_BYTES])
        for place in range(int(rng.integers(5)), len(block), 10):  # no frame is that short
            block[place] ^= int(rng.integers(1, 256))
        sent += len(block)
        yield bytes(block)


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_hostile_bytes_move_nothing(make_airborne, codec, option, say, resident_mb, kind):
    flight = make_airborne(f"{kind}://127.0.0.1:0")
    client, rng = flight.connect(), np.random.default_rng(1)
    total_bytes = option("hostile_bytes")
    before_mb = resident_mb()
    for block in blocks(codec, total_bytes, rng):
        client.send(block)
        flight.step()
    flight.fly_until(flight.world.time_s + 1.0)
    grown_mb = resident_mb() - before_mb
    moved_m = math.dist(flight.world.truth.position_ned_m, flight.start_ned_m)
    say(f"{kind}: {total_bytes} hostile bytes: moved {moved_m:.2f} m, memory {grown_mb:+.1f} MB")
    assert flight.autopilot.status.mode is FlightMode.HOLD
    assert flight.autopilot.status.armed
    assert moved_m < 0.3
    assert grown_mb < GROWTH_LIMIT_MB


def test_a_crowd_of_clients_is_served_as_far_as_there_is_room(make_airborne, codec):
    """All of them are the same system and component, and all want the vehicle."""
    flight = make_airborne("udpin://127.0.0.1:0")
    heartbeat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(codec)
    take_off = mavlink.MAVLink_command_long_message(1, 1, 22, 0, *[math.nan] * 7).pack(codec)
    crowd = [flight.connect() for _ in range(3 * MAX_CLIENTS)]
    for client in crowd:
        client.send(heartbeat)
        client.send(take_off)
    for _ in range(600):
        flight.step()
        for client in crowd:
            drain(client)
    assert len(flight.server.channels) == MAX_CLIENTS
    assert flight.autopilot.status.mode is FlightMode.HOLD
    assert math.dist(flight.world.truth.position_ned_m, flight.start_ned_m) < 0.3


def drain(client):
    try:
        while client.recv(4096):
            pass
    except BlockingIOError:
        pass
