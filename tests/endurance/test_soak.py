"""Hours of hovering: streams keep their rates, stamps do not drift, memory keeps its size."""

import math
from collections import Counter

import pytest
from pymavlink.dialects.v20 import common as mavlink

RATES_HZ = {"ATTITUDE": 100, "LOCAL_POSITION_NED": 30, "GPS_RAW_INT": 8, "HEARTBEAT": 1}
GROWTH_MB_PER_HOUR = 5.0
SETTLED_MB = 3.0
"""Buffers that fill once."""


def test_hovering_for_long_drifts_and_grows_nowhere(make_airborne, codec, option, say, resident_mb):
    flight = make_airborne("udpin://127.0.0.1:0")
    client = flight.connect()
    client.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(codec))
    hours = option("soak_hours")
    duration_s, began_s = round(3600.0 * hours), flight.world.time_s
    heard, memory_mb, newest_ms = Counter(), [], 0
    for second in range(duration_s):
        flight.fly_until(began_s + second + 1.0)
        flight.world.mocap.clear()  # as who publishes the truth does
        for message in received(client, codec):
            heard[message.get_type()] += 1
            newest_ms = max(newest_ms, getattr(message, "time_boot_ms", 0))
        if second % 60 == 0:
            client.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(codec))
            memory_mb.append(resident_mb())
    grown_mb = memory_mb[-1] - memory_mb[min(1, len(memory_mb) - 1)]
    moved_m = math.dist(flight.world.truth.position_ned_m, flight.start_ned_m)
    late_s = flight.world.time_s - newest_ms * 1e-3
    say(
        f"{hours:g} h hovering, {heard.total()} messages: memory {grown_mb:+.1f} MB, telemetry "
        f"{late_s * 1e3:.0f} ms behind, moved {moved_m:.2f} m"
    )
    for name, rate_hz in RATES_HZ.items():
        assert heard[name] == pytest.approx(rate_hz * duration_s, abs=1 + 1e-4 * duration_s), name
    assert grown_mb < SETTLED_MB + GROWTH_MB_PER_HOUR * hours
    assert late_s < 0.05
    assert moved_m < 0.5


def received(client, codec):
    while True:
        try:
            yield from codec.parse_buffer(client.recv(65536)) or []
        except BlockingIOError:
            return
