"""The two vehicles a card can fly: in this process on simulated time, or in one of its own."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, closing
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from companion.camera.remote import RemoteCamera
from companion.kernel.clock import WallClock
from companion.kernel.protocols import Rig
from companion.vehicle.deadman import DeadmanSettings
from companion.vehicle.mavsdk_vehicle import MavsdkSettings, MavsdkVehicle
from flightcard.order import Order
from sitl.build import build
from sitl.faults import Faults
from sitl.injection import inject
from sitl.lockstep import rig_of
from sitl.mavlink.texts import TextListener
from sitl.process import HOST, open_sitl

PATIENT = MavsdkSettings(deadman=DeadmanSettings(stop_after_s=10.0, exit_after_s=60.0))
"""A test's host may be busy with other tests; that it hangs is not what is tested."""


class Text(NamedTuple):
    """A STATUSTEXT; over MAVLink it does not say when, so that only the listener knows."""

    text: str
    time_s: float | None = None


class Machine(NamedTuple):
    """An open vehicle, and what only a test may do with it."""

    rig: Rig
    inject: Callable[[Faults], Coroutine[Any, Any, float]]
    """Makes things go wrong; the vehicle's time from which they act."""
    texts: Callable[[], list[Text]]
    """STATUSTEXTs since the last call."""
    watch: Callable[[], Coroutine[Any, Any, NoReturn]] | None = None
    """Raises what the vehicle's process died of, when it does."""
    spare_link: str | None = None
    """Where a further MAVLink client can speak to the vehicle, as the client's URL."""


@asynccontextmanager
async def open_lockstep(order: Order) -> AsyncIterator[Machine]:
    request = order.request
    simulation = build(Path(request.room), request.settings, request.seed, request.camera_rate_hz)
    autopilot = simulation.world.autopilot

    async def inject_now(faults: Faults) -> float:
        return inject(simulation.world, faults)

    def texts() -> list[Text]:
        return [Text(said.text, said.time_s) for said in autopilot.drain_status_texts()]

    yield Machine(rig_of(simulation), inject_now, texts)


@asynccontextmanager
async def open_sitl_process(order: Order) -> AsyncIterator[Machine]:
    """Through real MAVSDK and the camera's socket, as a companion would; free ports."""
    any_port = f"udpin://{HOST}:0"
    clock = WallClock(order.request.speed)
    async with open_sitl(order.request, [any_port, any_port]) as child:
        _, for_texts, spare = (link.replace("udpin", "udpout") for link in child.links)
        with closing(TextListener(for_texts)) as listener:

            def texts() -> list[Text]:
                return [Text(text) for text in listener.drain()]

            loop = asyncio.get_running_loop()
            loop.add_reader(listener, listener.collect)
            try:
                async with (
                    RemoteCamera(child.endpoints.camera_url) as camera,
                    MavsdkVehicle(child.endpoints.mavlink_url, clock, PATIENT) as vehicle,
                ):
                    rig = Rig(vehicle, camera, clock, camera)
                    yield Machine(rig, child.inject, texts, child.watch, spare)
            finally:
                loop.remove_reader(listener)
