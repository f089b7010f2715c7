"""A real MAVSDK ground station uploads plans and flies them, over UDP at ten times real time."""

import asyncio
import functools
import math
import statistics
from contextlib import asynccontextmanager
from pathlib import Path

import mavsdk.logging
import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.geofence import GeofenceAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.geofence import Circle, FenceType, GeofenceData, GeofenceError, Point
from mavsdk.plugins.mission_raw import MissionRawError

from companion.camera.remote import RemoteCamera
from companion.kernel.messages import SimulationRequest
from sitl.process import launch

PLANS = Path(__file__).parents[3] / "flightplans"
SPEED = 10.0
LIMIT_S = 60.0
"""Wall time, for a whole flight."""
CORNERS = [(1.5, -1.5), (1.5, 1.5), (-1.5, 1.5), (-1.5, -1.5)]


class Station:
    """A ground station's plugins on one vehicle."""

    def __init__(self, system, camera_url):
        self.action = ActionAsync(system)
        self.fence = GeofenceAsync(system)
        self.mission = MissionRawAsync(system)
        self.telemetry = TelemetryAsync(system)
        self.camera_url = camera_url


@functools.cache
def keep_stdout_clean():
    mavsdk.logging.log_subscribe(lambda *_: True)


@asynccontextmanager
async def ground_station(tmp_path):
    keep_stdout_clean()
    request = SimulationRequest(
        room=str(PLANS / "rooms" / "office.toml"),
        seed=1,
        speed=SPEED,
        camera_rate_hz=10.0,
        log_dir=str(tmp_path),
    )
    async with launch(request) as endpoints, asyncio.timeout(LIMIT_S):
        kind = ComponentType.GROUND_STATION
        library = Mavsdk(Configuration.create_with_component_type(kind))
        try:
            await library.add_any_connection(endpoints.mavlink_url)
            system = await library.first_autopilot(10.0)
            yield Station(system, endpoints.camera_url)
        finally:
            await asyncio.to_thread(library.destroy)


async def until_armable(station):
    async for health in station.telemetry.subscribe_health():
        if health.is_armable:
            return


async def truths_until_landed(station):
    """True positions of the flight, from motion capture beside the frames."""
    poses = []
    async with RemoteCamera(station.camera_url) as camera:
        async for _ in camera.frames():
            poses += camera.drain()
            flying = poses and poses[-1].truth_position_ned_m[2] < -0.3
            flew = min((p.truth_position_ned_m[2] for p in poses), default=0.0) < -1.0
            if flew and not flying:
                return poses
    return poses


async def follow(station, seen):
    async for progress in station.mission.subscribe_mission_progress():
        seen.append(progress.current)


async def first_text(station, word):
    async for text in station.telemetry.subscribe_status_text():
        if word in text.text:
            return text.text
    raise AssertionError


async def refuse_bad_plans(station, items):
    said = asyncio.create_task(first_text(station, "rejected"))
    await station.fence.upload_geofence(circle(1.0))
    while not said.done():  # texts come once its first heartbeat was heard
        with pytest.raises(MissionRawError):
            await station.mission.upload_mission(items)
    assert await said == "Item 2 rejected: outside the geofence"
    with pytest.raises(GeofenceError):
        await station.fence.upload_geofence(circle(-1.0))
    await station.fence.clear_geofence()
    assert await station.mission.download_mission() == []


def circle(radius_m):
    return GeofenceData([], [Circle(Point(51.9906, 4.3768), radius_m, FenceType.INCLUSION)])


async def upload_and_fly(station, plan):
    """(numbers of the items flown, truth)."""
    await station.mission.upload_geofence(plan.geofence_items)
    await station.mission.upload_mission(plan.mission_items)
    back = await station.mission.download_mission()
    assert [(i.command, i.x, i.y) for i in back] == [
        (i.command, i.x, i.y) for i in plan.mission_items
    ]
    assert len(await station.mission.download_geofence()) == 4
    await until_armable(station)
    await station.action.arm()
    await station.mission.start_mission()
    seen = []
    progress = asyncio.create_task(follow(station, seen))
    poses = await truths_until_landed(station)
    assert (await station.mission.is_mission_finished()) is True
    progress.cancel()
    return seen, poses


def test_a_qgroundcontrol_plan_is_flown_unchanged_and_bad_ones_are_refused(tmp_path):
    async def run():
        async with ground_station(tmp_path) as station:
            plan = await station.mission.import_qgroundcontrol_mission(str(PLANS / "square.plan"))
            await refuse_bad_plans(station, plan.mission_items)
            return await upload_and_fly(station, plan)

    seen, poses = asyncio.run(run())
    visited = [number for at, number in enumerate(seen) if at == 0 or seen[at - 1] != number]
    assert [number for number in visited if 2 <= number <= 5] == [2, 3, 4, 5]
    for corner in CORNERS:
        distances = (math.dist(pose.truth_position_ned_m[:2], corner) for pose in poses)
        assert min(distances) < 0.6  # the estimate drifts
    heights = [-pose.truth_position_ned_m[2] for pose in poses if pose.truth_position_ned_m[2] < -1]
    assert statistics.median(heights) == pytest.approx(1.25, abs=0.15)
    assert poses[-1].truth_collisions == 0
    assert math.hypot(*poses[-1].truth_position_ned_m[:2]) < 0.8
