"""MAVSDK 4's own API flies every kind of offboard setpoint and an orbit."""

import asyncio
import functools
import math
from contextlib import aclosing, asynccontextmanager
from pathlib import Path

import mavsdk.logging
import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.events import EventsAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.events import EventsError
from mavsdk.plugins.offboard import (
    AccelerationNed,
    Attitude,
    AttitudeRate,
    PositionGlobalYaw,
    PositionNedYaw,
    VelocityBodyYawspeed,
    VelocityNedYaw,
)
from mavsdk.plugins.telemetry import FlightMode

from companion.kernel.messages import SimulationRequest
from sitl.mavlink.places import Origin
from sitl.process import launch

ROOM = str(Path(__file__).parents[2] / "flightplans" / "rooms" / "office.toml")
LIMIT_S = 60.0
"""Wall time, for a whole flight."""
HEIGHT_M = 1.5


class Drone:
    """The plugins of one vehicle."""

    def __init__(self, system):
        self.action = ActionAsync(system)
        self.events = EventsAsync(system)
        self.offboard = OffboardAsync(system)
        self.telemetry = TelemetryAsync(system)

    async def take_off(self):
        await until(self.telemetry.subscribe_health(), lambda health: health.is_armable)
        await self.action.set_takeoff_altitude(HEIGHT_M)
        await self.action.arm()
        await self.action.takeoff()
        await until(self.motion(), lambda m: abs(m.position.down_m + HEIGHT_M) < 0.1)
        await self.in_mode(FlightMode.HOLD)

    def motion(self):
        return self.telemetry.subscribe_position_velocity_ned()

    async def in_mode(self, mode):
        await until(self.telemetry.subscribe_flight_mode(), lambda now: now == mode)

    async def reaches(self, north_m, east_m):
        def there(motion):
            place = motion.position
            return math.dist((place.north_m, place.east_m), (north_m, east_m)) < 0.15

        return await until(self.motion(), there)

    async def flies(self, north_m_s, east_m_s):
        def so_fast(motion):
            speed = motion.velocity
            return math.dist((speed.north_m_s, speed.east_m_s), (north_m_s, east_m_s)) < 0.1

        return await until(self.motion(), so_fast)


async def until(stream, wanted):
    """The first of the stream that is wanted."""
    async with aclosing(stream):
        async for item in stream:
            if wanted(item):
                return item
    raise AssertionError("the stream ended")


@functools.cache
def keep_stdout_clean():
    mavsdk.logging.log_subscribe(lambda *_: True)


@asynccontextmanager
async def drone(tmp_path, speed):
    keep_stdout_clean()
    request = SimulationRequest(
        room=ROOM,
        seed=1,
        speed=speed,
        camera_rate_hz=10.0,
        log_dir=str(tmp_path),
    )
    async with launch(request) as endpoints, asyncio.timeout(LIMIT_S):
        kind = ComponentType.COMPANION_COMPUTER
        library = Mavsdk(Configuration.create_with_component_type(kind))
        try:
            await library.add_any_connection(endpoints.mavlink_url)
            yield Drone(await library.first_autopilot(10.0))
        finally:
            await asyncio.to_thread(library.destroy)


async def fly_by_position_and_velocity(drone):
    await drone.offboard.set_position_ned(PositionNedYaw(1.0, 0.5, -HEIGHT_M, 90.0))
    await drone.offboard.start()
    await drone.reaches(1.0, 0.5)
    east = await until(drone.telemetry.subscribe_attitude_euler(), lambda a: a.yaw_deg > 85.0)
    assert east.yaw_deg == pytest.approx(90.0, abs=6.0)
    await drone.offboard.set_velocity_ned(VelocityNedYaw(-0.5, 0.0, 0.0, 90.0))
    await drone.flies(-0.5, 0.0)
    await drone.offboard.set_velocity_body(VelocityBodyYawspeed(0.0, -0.4, 0.0, 0.0))
    await drone.flies(0.4, 0.0)  # its left, for it heads east
    await drone.offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 60.0))
    turns = drone.telemetry.subscribe_attitude_angular_velocity_body()
    await until(turns, lambda turn: abs(turn.yaw_rad_s - math.radians(60.0)) < 0.1)
    await drone.offboard.set_position_velocity_ned(
        PositionNedYaw(0.0, 0.0, -HEIGHT_M, 0.0), VelocityNedYaw(0.0, 0.0, 0.0, 0.0)
    )
    await drone.reaches(0.0, 0.0)
    latitude_deg, longitude_deg = Origin().degrees((0.0, 1.0, 0.0))
    above_home = PositionGlobalYaw.AltitudeType.REL_HOME
    await drone.offboard.set_position_global(
        PositionGlobalYaw(latitude_deg, longitude_deg, HEIGHT_M, 0.0, above_home)
    )
    await drone.reaches(0.0, 1.0)


async def fly_by_force_and_attitude(drone):
    await drone.offboard.set_acceleration_ned(AccelerationNed(0.5, 0.0, 0.0))
    await until(drone.motion(), lambda motion: motion.velocity.north_m_s > 0.4)
    await drone.offboard.set_attitude(Attitude(0.0, 8.0, 0.0, 0.58))
    pitches = drone.telemetry.subscribe_attitude_euler()
    await until(pitches, lambda attitude: abs(attitude.pitch_deg - 8.0) < 1.5)
    await drone.offboard.set_attitude_rate(AttitudeRate(0.0, 0.0, 40.0, 0.58))
    turns = drone.telemetry.subscribe_attitude_angular_velocity_body()
    await until(turns, lambda turn: abs(turn.yaw_rad_s - math.radians(40.0)) < 0.1)
    await drone.offboard.stop()
    await drone.in_mode(FlightMode.HOLD)


async def orbit_and_land(drone):
    origin, radius_m = Origin(), 1.0
    await drone.action.do_orbit(
        radius_m, 0.5, 0, origin.latitude_deg, origin.longitude_deg, origin.amsl_m + HEIGHT_M
    )
    await drone.in_mode(FlightMode.POSCTL)  # MAVSDK has no word for orbits
    for _ in range(2):  # on both sides of the centre
        for side in (1.0, -1.0):
            await until(drone.motion(), lambda m, s=side: s * m.position.north_m > 0.85)
    await drone.action.land()
    await until(drone.telemetry.subscribe_armed(), lambda armed: not armed)


async def ask_for_what_is_not_there(drone):
    """Without EVENT, MAVSDK has no arming report; it says so instead of waiting."""
    with pytest.raises(ActionError, match="COMMAND_DENIED"):
        await drone.action.set_actuator(1, 0.5)
    with pytest.raises(ActionError, match="UNSUPPORTED"):
        await drone.action.set_relay(1, 0)
    origin = Origin()
    await drone.action.set_gps_global_origin(
        origin.latitude_deg, origin.longitude_deg, origin.amsl_m
    )
    with pytest.raises(EventsError, match="NOT_AVAILABLE"):
        await drone.events.get_health_and_arming_checks_report()


def test_every_offboard_setpoint_and_an_orbit_fly_as_asked(tmp_path):
    async def run():
        async with drone(tmp_path, 5.0) as it:
            await ask_for_what_is_not_there(it)
            await it.take_off()
            await fly_by_position_and_velocity(it)
            await fly_by_force_and_attitude(it)
            await orbit_and_land(it)

    asyncio.run(run())
