"""Opens what a flight needs: from the words on the command line to a vehicle and a camera."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import entry_points
from typing import cast

from companion.camera.remote import RemoteCamera
from companion.camera.spec import open_camera, parse_camera
from companion.kernel.clock import WallClock
from companion.kernel.errors import PlanError
from companion.kernel.messages import SimulationRequest
from companion.kernel.protocols import Endpoints, MotionCapture, Rig, Simulator, StereoCamera
from companion.vehicle.mavsdk_vehicle import MavsdkVehicle

SIMULATORS = "companion.simulators"
SIMULATED_CAMERA = "sitl"
"""The simulator's own, also where there is no process to get it from."""
MAVLINK_SCHEMES = frozenset(
    {"udp", "udpin", "udpout", "tcp", "tcpin", "tcpout", "serial", "serial_flowcontrol"}
)


@asynccontextmanager
async def open_rig(
    vehicle: str, camera: str, speed: float, request: SimulationRequest | None
) -> AsyncIterator[Rig]:
    """``vehicle``, ``camera``, ``speed`` as on the command line; a simulator needs a ``request``.

    Raises PlanError for words that mean nothing; the devices raise their own errors when a flight
    opens them.
    """
    simulators = {point.name: point for point in entry_points(group=SIMULATORS)}
    parse_camera(camera, (SIMULATED_CAMERA,))  # refuses nonsense before anything is started
    if vehicle in simulators and request is not None:
        simulator = cast(Simulator, simulators[vehicle].load())
        async with simulator(request) as opened:
            yield _simulated_rig(opened, vehicle, camera, request)
        return
    if vehicle.partition("://")[0] not in MAVLINK_SCHEMES or "://" not in vehicle:
        allowed = ", ".join((*sorted(simulators), "a MAVLink URL such as udpin://0.0.0.0:14540"))
        raise PlanError(f"--vehicle {vehicle}: unknown; allowed: {allowed}")
    if camera == SIMULATED_CAMERA:
        raise PlanError(
            f"--camera {camera}: needs a simulator as --vehicle; name the camera's URL or path"
        )
    clock = WallClock(speed)
    yield _rig(vehicle, open_camera(camera, clock), clock)


def _simulated_rig(
    opened: Rig | Endpoints, vehicle: str, camera: str, request: SimulationRequest
) -> Rig:
    if isinstance(opened, Endpoints):
        clock = WallClock(request.speed)
        url = opened.camera_url if camera == SIMULATED_CAMERA else camera
        return _rig(opened.mavlink_url, open_camera(url, clock), clock)
    if camera != SIMULATED_CAMERA:
        raise PlanError(f"--camera {camera}: {vehicle} brings its own; allowed: {SIMULATED_CAMERA}")
    return opened


def _rig(mavlink_url: str, camera: StereoCamera, clock: WallClock) -> Rig:
    mocap = cast(MotionCapture, camera) if isinstance(camera, RemoteCamera) else None
    return Rig(MavsdkVehicle(mavlink_url, clock), camera, clock, mocap)


def needs_room(vehicle: str) -> bool:
    """Whether this vehicle is a simulator, which flies in the plan's room."""
    return vehicle in {point.name for point in entry_points(group=SIMULATORS)}
