"""Invented flights, as three kinds of log: ours, a ground station's, PX4's."""

import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.flightlog import FlightLogWriter, FlightMetadata, Topic
from companion.kernel.messages import (
    BehaviourState,
    Cue,
    Decision,
    Percept,
    Phase,
    Setpoint,
    Telemetry,
)
from sitl.mavlink.framing import Source, encode
from sitl.mavlink.tlog import TelemetryLog

STEP_S = 0.1
BOOT_S = 5.0


class Motion:
    """An invented flight: turns at random times, a height that wanders; both smooth."""

    def __init__(self, seed, duration_s=60.0):
        rng = np.random.default_rng(seed)
        self.duration_s = duration_s
        self._turns_s = np.sort(rng.uniform(BOOT_S, BOOT_S + duration_s, 14))
        self._signs = rng.choice([-1.0, 1.0], 14)
        self._waves = rng.uniform((0.02, 0.0), (0.2, 6.0), (4, 2))

    def yaw_rate_rad_s(self, time_s):
        bumps = np.exp(-(((time_s - self._turns_s) / 0.8) ** 2))
        return float(0.8 * np.sum(self._signs * bumps))

    def down_m(self, time_s):
        hz, phase = self._waves.T
        return -1.2 + 0.1 * float(np.sum(np.sin(2 * np.pi * hz * time_s + phase)))

    def times_s(self, rate_hz):
        return BOOT_S + np.arange(0.0, self.duration_s, 1.0 / rate_hz)


def frame_records(stamp_ns):
    percept = Percept(
        stamp_ns=stamp_ns,
        stereo_px=2.0,
        stereo_valid_norm=0.5,
        mono_px=2.5,
        mono_std_px=0.1,
    )
    decision = Decision(
        stamp_ns=stamp_ns,
        phase=Phase.TEST,
        cue=Cue.MONO,
        override=False,
        disparity_px=2.5,
        threshold_px=4.0,
        state=BehaviourState.STRAIGHT,
        overrides=0,
        turns=0,
        approaches=1,
    )
    return [
        (Topic.PERCEPT, percept),
        (Topic.DECISION, decision),
        (Topic.SETPOINT, Setpoint(stamp_ns=stamp_ns)),
    ]


def telemetry(motion, time_s, known=True):
    yaw_rate_rad_s = motion.yaw_rate_rad_s(time_s) if known else np.nan
    return Telemetry(
        stamp_ns=round(time_s * 1e9),
        position_ned_m=(0.0, 0.0, motion.down_m(time_s)),
        yaw_rate_rad_s=yaw_rate_rad_s,
    )


def write_flight(path, motion, camera_ahead_s=0.0, skip=(), yaw_known=True):
    """Frames on the camera's clock; telemetry on the autopilot's, which is behind by so much."""
    metadata = FlightMetadata(plan={"room": "room1"}, seed=1, version="0.1.0")
    with FlightLogWriter(path, metadata) as log:
        for index, time_s in enumerate(motion.times_s(1.0 / STEP_S)):
            if index in skip:
                continue
            stamp_ns = round((time_s + camera_ahead_s) * 1e9)
            for topic, record in frame_records(stamp_ns):
                log.write(topic, record)
            log.write(Topic.TELEMETRY, telemetry(motion, time_s, yaw_known), log_time_ns=stamp_ns)
    return path


def write_tlog(path, motion, clock_s=0.0, rate_hz=25.0):
    """The same flight on a clock that is ahead of the autopilot's by ``clock_s``."""
    log = TelemetryLog(path)
    for sequence, time_s in enumerate(motion.times_s(rate_hz)):
        boot_ms = round(time_s * 1e3)
        rates = (0.0, 0.0, motion.yaw_rate_rad_s(time_s))
        place = (0.0, 0.0, motion.down_m(time_s), 0.0, 0.0, 0.0)
        attitude = mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, *rates)
        local = mavlink.MAVLink_local_position_ned_message(boot_ms, *place)
        log.write(time_s + clock_s, encode(attitude).packed((2 * sequence) % 256, Source()))
        log.write(time_s + clock_s, encode(local).packed((2 * sequence + 1) % 256, Source()))
    log.close()
    return path


def write_ulog(path, motion, clock_s=0.0, rate_hz=50.0, dropout_ms=0):
    """A small ULog file, by PX4's description of the format."""

    def message(kind, content):
        return struct.pack("<HB", len(content), ord(kind)) + content

    parts = [b"ULog\x01\x12\x35\x01", struct.pack("<Q", round((BOOT_S + clock_s) * 1e6))]
    parts += [
        message("B", bytes(40)),
        message("F", b"vehicle_angular_velocity:uint64_t timestamp;float[3] xyz;"),
        message("I", b"\x10char[3] sys_namePX4"),
        message("A", struct.pack("<BH", 0, 1) + b"vehicle_angular_velocity"),
    ]
    for time_s in motion.times_s(rate_hz):
        stamp_us = round((time_s + clock_s) * 1e6)
        xyz = (0.0, 0.0, motion.yaw_rate_rad_s(time_s))
        parts.append(message("D", struct.pack("<HQ3f", 1, stamp_us, *xyz)))
    if dropout_ms:
        parts.append(message("O", struct.pack("<H", dropout_ms)))
    path.write_bytes(b"".join(parts))
    return path


class Writers:
    """Everything that a test writes logs with."""

    Motion = Motion
    flight = staticmethod(write_flight)
    tlog = staticmethod(write_tlog)
    ulog = staticmethod(write_ulog)


@pytest.fixture(scope="session")
def invented():
    return Writers
