"""``sitl run`` in the air, its camera and telemetry read: what it takes, and whether it keeps up.

The vehicle hovers; the client is the companion's own MAVLink adapter, in this process.
"""

import asyncio
import os
import tempfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from companion.camera.remote import RemoteCamera
from companion.kernel.clock import WallClock, wall_s
from companion.kernel.messages import SimulationRequest
from companion.plan import load_plan, room_path
from companion.vehicle.deadman import DeadmanSettings
from companion.vehicle.mavsdk_vehicle import MavsdkSettings, MavsdkVehicle
from sitl.build import build
from sitl.process import open_sitl
from tools.bench.harness import PLAN, Row

MEASURED_S = 15.0
"""Wall time."""
ALONE_S = 300.0
SHARE_GOAL_PERCENT = 35.0
SPEED_GOAL_PERCENT = 2.0
HEIGHT_M = 1.2
PATIENT = MavsdkSettings(deadman=DeadmanSettings(stop_after_s=10.0))
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Kept(NamedTuple):
    """Of one run: times real time, and what the process used."""

    speed: float
    cpu_per_flight_s: float
    """Seconds of a core for a second of flight: its share of a core at speed 1."""


def rows() -> Iterator[Row]:
    slow, fast = (asyncio.run(keep_up(*case)) for case in ((1.0, 30.0), (10.0, 10.0)))
    yield Row.of(
        "sitl run, speed 1, camera at 30 Hz: share of a core",
        100.0 * slow.cpu_per_flight_s,
        "%",
        ("physics and autopilot alone", 100.0 * _world_share()),
        goal=SHARE_GOAL_PERCENT,
    )
    yield Row.of(
        "sitl run, speed 10, camera at 10 Hz: speed is off by",
        100.0 * abs(fast.speed / 10.0 - 1.0),
        "%",
        ("its share of a core then", 1000.0 * fast.cpu_per_flight_s),
        goal=SPEED_GOAL_PERCENT,
    )


async def keep_up(speed: float, camera_rate_hz: float) -> Kept:
    """Hovers for MEASURED_S, with every frame and all telemetry read."""
    plan = load_plan(PLAN)
    with tempfile.TemporaryDirectory() as folder:
        request = SimulationRequest(
            room=str(room_path(plan, PLAN)),
            seed=plan.seed,
            speed=speed,
            camera_rate_hz=camera_rate_hz,
            log_dir=folder,
        )
        async with (
            open_sitl(request) as sitl,
            RemoteCamera(sitl.endpoints.camera_url) as camera,
            MavsdkVehicle(sitl.endpoints.mavlink_url, WallClock(speed), PATIENT) as vehicle,
        ):
            await vehicle.take_off(HEIGHT_M)
            return await _measure(camera, sitl.pid)


async def _measure(camera: RemoteCamera, pid: int) -> Kept:
    """From one frame to the last one that comes within MEASURED_S."""
    frames = camera.frames()
    first = await anext(frames)
    began_s, began_cpu_s = wall_s(), _cpu_s(pid)
    frame, took_s = first, 0.0
    while took_s < MEASURED_S:
        frame = await anext(frames)
        took_s = wall_s() - began_s
    flown_s = (frame.stamp_ns - first.stamp_ns) * 1e-9
    return Kept(flown_s / took_s, (_cpu_s(pid) - began_cpu_s) / flown_s)


def _cpu_s(pid: int) -> float:
    """User and system time that a process has used; fields 14 and 15 of proc(5)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, islice(fields, 11, 13))) / _TICKS_PER_S


def _world_share() -> float:
    """Seconds of CPU per second of flight of the world alone."""
    plan = load_plan(PLAN)
    world = build(room_path(plan, PLAN), plan.sitl, plan.seed, plan.camera.rate_hz).world
    began_s = _cpu_s(os.getpid())
    world.advance_to(ALONE_S)
    return (_cpu_s(os.getpid()) - began_s) / ALONE_S
