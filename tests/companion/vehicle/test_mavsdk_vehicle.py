"""MAVSDK against the simulated autopilot in its own process, over real UDP."""

import asyncio
import itertools
import math
import socket
import sys
import threading
from asyncio.subprocess import PIPE
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.camera.remote import RemoteCamera
from companion.kernel.clock import WallClock, wall_s
from companion.kernel.errors import LinkError, VehicleError
from companion.kernel.messages import FlightMode, LandedState, Setpoint, SimulationRequest
from companion.vehicle.deadman import DeadmanSettings
from companion.vehicle.mavsdk_vehicle import MavsdkSettings, MavsdkVehicle
from sitl.process import launch, reserved_mavlink_port

ROOM = Path(__file__).parents[3] / "flightplans" / "rooms" / "room1.toml"
SPEED = 10.0


def request(tmp_path, **changes):
    fields = {"room": str(ROOM), "seed": 1, "speed": SPEED, "camera_rate_hz": 10.0}
    return SimulationRequest(**{**fields, "log_dir": str(tmp_path), **changes})


@asynccontextmanager
async def flying_machine(tmp_path, limits=None, **changes):
    """An open vehicle, its clock and where the simulator is."""
    async with launch(request(tmp_path, **changes)) as endpoints:
        clock = WallClock(SPEED)
        async with MavsdkVehicle(endpoints.mavlink_url, clock, limits) as vehicle:
            yield vehicle, clock, endpoints


async def fly(vehicle, clock, duration_s, **setpoint):
    end_ns = vehicle.telemetry().stamp_ns + round(duration_s * 1e9)
    while vehicle.telemetry().stamp_ns < end_ns:
        await vehicle.send(Setpoint(stamp_ns=vehicle.telemetry().stamp_ns, **setpoint))
        await clock.sleep(0.1)


def test_a_whole_flight(tmp_path):
    limits = MavsdkSettings(
        deadman=DeadmanSettings(stop_after_s=10.0, exit_after_s=60.0)
    )  # a busy host is no hang

    async def run():
        async with flying_machine(tmp_path, limits) as (vehicle, clock, endpoints):
            await vehicle.take_off(1.2)
            up = vehicle.telemetry()
            assert -up.position_ned_m[2] == pytest.approx(1.2, abs=0.3)
            assert (up.flight_mode, up.landed_state) == (FlightMode.HOLD, LandedState.IN_AIR)
            assert up.armed
            assert 0.5 < up.battery_norm <= 1.0

            await vehicle.start_offboard(Setpoint(stamp_ns=up.stamp_ns))
            await fly(vehicle, clock, 3.0, velocity_hfrd_m_s=(0.4, 0.0, 0.0))
            ahead = vehicle.telemetry()
            north_m_s, east_m_s, _ = ahead.velocity_ned_m_s
            assert math.hypot(north_m_s, east_m_s) == pytest.approx(0.4, abs=0.1)
            assert math.atan2(east_m_s, north_m_s) == pytest.approx(ahead.yaw_rad, abs=0.3)

            await fly(vehicle, clock, 3.0, yaw_rate_rad_s=0.5)
            turning = vehicle.telemetry()
            assert turning.yaw_rate_rad_s == pytest.approx(0.5, abs=0.1)
            assert math.remainder(turning.yaw_rad - ahead.yaw_rad, math.tau) > 0.8

            await vehicle.hold()
            assert vehicle.telemetry().flight_mode is FlightMode.HOLD
            await look(endpoints.camera_url, vehicle)
            await vehicle.land()
            down = vehicle.telemetry()
            assert (down.armed, down.landed_state) == (False, LandedState.ON_GROUND)
            assert down.position_ned_m[2] == pytest.approx(0.0, abs=0.2)
            await vehicle.land()  # nothing to do on the ground

    asyncio.run(run())
    assert (tmp_path / "flight.tlog").stat().st_size > 100_000


async def look(url, vehicle):
    """Frames come beside the telemetry, on the same clock, and truth with them."""
    async with RemoteCamera(url) as camera:
        stamps = []
        async for frame in camera.frames():
            assert frame.left.shape == (camera.calibration.height_px, camera.calibration.width_px)
            stamps.append(frame.stamp_ns)
            if len(stamps) == 10:
                break
        assert min(b - a for a, b in itertools.pairwise(stamps)) == pytest.approx(1e8)
        assert len(camera.drain()) >= 80
        assert vehicle.telemetry().stamp_ns == pytest.approx(stamps[-1], abs=1.5e9)


def test_a_refusal_says_what_was_refused(tmp_path):
    limits = MavsdkSettings(ready_limit_s=1.0)
    never_ready = {"estimator": {"ready_after_s": 1e6}}

    async def run():
        async with flying_machine(tmp_path, limits, settings=never_ready) as (vehicle, _, _):
            await vehicle.take_off(1.0)

    expected = r"^arm: refused by the autopilot \(command denied\); not ready: .*pre-arm checks"
    with pytest.raises(VehicleError, match=expected):
        asyncio.run(run())


def test_a_killed_simulator_is_a_lost_link():
    words = [sys.executable, "-m", "sitl", "run", str(ROOM), "--speed", str(SPEED)]
    words += ["--camera", "tcp://127.0.0.1:0", "--mavlink"]

    async def run(address):
        process = await asyncio.create_subprocess_exec(*words, f"udpout://{address}", stdout=PIPE)
        assert b"ready" in await process.stdout.readline()
        clock, settings = WallClock(SPEED), MavsdkSettings(silence_limit_s=0.5)
        async with MavsdkVehicle(f"udpin://{address}", clock, settings) as vehicle:
            await vehicle.take_off(1.0)
            process.kill()
            await process.wait()
            await fly(vehicle, clock, 60.0)

    expected = r"^udpin://.*: nothing from the autopilot for \d\.\d s$"
    with reserved_mavlink_port() as port, pytest.raises(LinkError, match=expected):
        asyncio.run(run(f"127.0.0.1:{port}"))


class DeafTo(asyncio.DatagramProtocol):
    """Carries datagrams between a vehicle and its client; commands of one kind are lost."""

    def __init__(self, client):
        self.client, self._vehicle = client, None
        self._parser = mavlink.MAVLink(None)
        self.lost_command = self.lost = 0

    def connection_made(self, transport):
        self._transport = transport

    def datagram_received(self, data, sender):
        if sender != self.client:
            self._vehicle = sender
            self._transport.sendto(data, self.client)
        elif not self._is_lost(data):
            self._transport.sendto(data, self._vehicle)

    def _is_lost(self, data):
        messages = self._parser.parse_buffer(data) or []
        lost = any(getattr(m, "command", None) == self.lost_command for m in messages)
        self.lost += lost
        return lost


@asynccontextmanager
async def flying_behind(lossy):
    """An open vehicle in offboard mode at 0.4 m/s, behind DeafTo, whose deadman never acts."""
    words = [sys.executable, "-m", "sitl", "run", str(ROOM), "--speed", str(SPEED)]
    words += ["--camera", "tcp://127.0.0.1:0", "--mavlink"]
    never = DeadmanSettings(stop_after_s=1e3, hold_after_s=1e3, land_after_s=1e3, exit_after_s=60.0)
    loop = asyncio.get_running_loop()
    relay, _ = await loop.create_datagram_endpoint(lambda: lossy, local_addr=("127.0.0.1", 0))
    address = "udpout://{}:{}".format(*relay.get_extra_info("sockname"))
    process = await asyncio.create_subprocess_exec(*words, address, stdout=PIPE)
    try:
        assert b"ready" in await process.stdout.readline()
        clock, limits = WallClock(SPEED), MavsdkSettings(deadman=never)
        async with MavsdkVehicle("udpin://{}:{}".format(*lossy.client), clock, limits) as vehicle:
            await vehicle.take_off(1.0)
            await vehicle.start_offboard(Setpoint(stamp_ns=0))
            await fly(vehicle, clock, 1.0, velocity_hfrd_m_s=(0.4, 0.0, 0.0))
            yield vehicle, clock
    finally:
        process.kill()
        await process.wait()
        relay.close()


@pytest.mark.parametrize(
    ("verb", "command"),
    [("hold", mavlink.MAV_CMD_DO_SET_MODE), ("land", mavlink.MAV_CMD_NAV_LAND)],
)
def test_it_stands_still_while_the_autopilot_does_not_hear_its_command(verb, command):
    """MAVSDK repeats a command each half second and the last setpoint twenty times a second."""

    async def run(port):
        lossy = DeafTo(("127.0.0.1", port))
        async with flying_behind(lossy) as (vehicle, clock):
            lossy.lost_command = command
            began_ned_m = vehicle.telemetry().position_ned_m
            asked = asyncio.create_task(getattr(vehicle, verb)())
            while lossy.lost < 2:  # half a second of wall time, five of the vehicle's
                await clock.sleep(0.1)
            assert vehicle.telemetry().flight_mode is FlightMode.OFFBOARD
            assert math.dist(vehicle.telemetry().position_ned_m, began_ned_m) < 0.6
            lossy.lost_command = 0
            await asked

    with reserved_mavlink_port() as port:
        asyncio.run(run(port))


def test_it_can_be_closed_while_a_command_is_on_its_way():
    """The command ends first, answered or given up; MAVSDK would never return from it."""

    async def run(port):
        lossy = DeafTo(("127.0.0.1", port))
        async with flying_behind(lossy) as (vehicle, clock):
            lossy.lost_command = mavlink.MAV_CMD_DO_SET_MODE
            asked = asyncio.create_task(vehicle.hold())
            while not lossy.lost:
                await clock.sleep(0.1)
            asked.cancel()

    with reserved_mavlink_port() as port:
        asyncio.run(run(port))
    assert not [t for t in threading.enumerate() if t.name.startswith("request")]


def test_no_autopilot_is_said_in_one_line():
    async def run(url):
        async with MavsdkVehicle(url, WallClock(), MavsdkSettings(heartbeat_limit_s=0.3)):
            pass

    began_s = wall_s()
    expected = r"^udpin://127.0.0.1:\d+: no autopilot heartbeat within 0.3 s$"
    with reserved_mavlink_port() as port, pytest.raises(LinkError, match=expected):
        asyncio.run(run(f"udpin://127.0.0.1:{port}"))
    assert wall_s() - began_s < 2.0


def test_a_busy_port_is_said_in_one_line():
    async def run(url):
        async with MavsdkVehicle(url, WallClock()):
            pass

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        url = "udpin://{}:{}".format(*taken.getsockname())
        with pytest.raises(LinkError, match=r"^udpin://.*: cannot be opened: the port is in use$"):
            asyncio.run(run(url))
