"""Opens what a flight needs: from the words on the command line to a vehicle and a camera."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import entry_points
from typing import cast

from companion.camera.remote import RemoteCamera
from companion.camera.spec import open_camera
from companion.kernel.clock import WallClock
from companion.kernel.errors import PlanError
from companion.kernel.messages import SimulationRequest
from companion.kernel.protocols import Endpoints, MotionCapture, Rig, Simulator, StereoCamera
from companion.vehicle.mavsdk_vehicle import MavsdkVehicle

SIMULATORS = "companion.simulators"


@asynccontextmanager
async def open_rig(
    vehicle: str, camera: str, request: SimulationRequest | None
) -> AsyncIterator[Rig]:
    """``vehicle`` and ``camera`` as on the command line; a simulator needs a ``request``.

    Raises PlanError for words that mean nothing; the devices raise their own errors when a flight
    opens them.
    """
    simulators = {point.name: point for point in entry_points(group=SIMULATORS)}
    if vehicle in simulators and request is not None:
        simulator = cast(Simulator, simulators[vehicle].load())
        async with simulator(request) as opened:
            yield opened if isinstance(opened, Rig) else _remote_rig(opened, camera, request)
        return
    if "://" not in vehicle:
        allowed = ", ".join((*sorted(simulators), "a MAVLink URL such as udpin://0.0.0.0:14540"))
        raise PlanError(f"--vehicle {vehicle}: unknown; allowed: {allowed}")
    if camera == "sitl":
        raise PlanError("--camera sitl needs --vehicle sitl; name the camera's URL or path")
    clock = WallClock(request.speed if request else 1.0)
    yield _rig(vehicle, open_camera(camera, clock), clock)


def _remote_rig(endpoints: Endpoints, camera: str, request: SimulationRequest) -> Rig:
    clock = WallClock(request.speed)
    url = endpoints.camera_url if camera == "sitl" else camera
    return _rig(endpoints.mavlink_url, open_camera(url, clock), clock)


def _rig(mavlink_url: str, camera: StereoCamera, clock: WallClock) -> Rig:
    mocap = cast(MotionCapture, camera) if isinstance(camera, RemoteCamera) else None
    return Rig(MavsdkVehicle(mavlink_url, clock), camera, clock, mocap)


def needs_room(vehicle: str) -> bool:
    """Whether this vehicle is a simulator, which flies in the plan's room."""
    return vehicle in {point.name for point in entry_points(group=SIMULATORS)}
