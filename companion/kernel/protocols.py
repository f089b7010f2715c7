"""The contracts at the companion's border: a vehicle, a camera, a motion-capture system."""

from collections.abc import AsyncGenerator, Sequence
from contextlib import AbstractAsyncContextManager
from types import TracebackType
from typing import NamedTuple, Protocol, Self

from companion.kernel.calibration import StereoCalibration
from companion.kernel.clock import Clock
from companion.kernel.messages import (
    Event,
    MocapPose,
    Setpoint,
    SimulationRequest,
    StereoFrame,
    Telemetry,
)


class _Device(Protocol):
    """Opened by ``async with``; opening raises the package's error, closing never does."""

    async def __aenter__(self) -> Self: ...

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...


class StereoCamera(_Device, Protocol):
    """A source of synchronised pairs. In lockstep, asking for the next one advances the world."""

    @property
    def calibration(self) -> StereoCalibration: ...

    @property
    def frames_dropped(self) -> int:
        """Frames that came while the consumer was busy; the newest wins."""
        ...

    def frames(self) -> AsyncGenerator[StereoFrame, None]:
        """Yields each newest frame once; ends when the source has no more.

        Raises CameraError for a frame of another geometry than the calibration declares.
        """
        ...


class Vehicle(_Device, Protocol):
    """An autopilot in offboard mode. Verbs return when telemetry confirms them.

    Each raises VehicleError (refused, or not confirmed in time) or LinkError (gone).
    """

    def telemetry(self) -> Telemetry:
        """The newest state, without waiting."""
        ...

    async def arm(self) -> None:
        """As soon as the autopilot is ready. It disarms by itself when nothing follows."""
        ...

    async def take_off(self, height_m: float) -> None:
        """Arms, climbs to ``height_m`` above home and hovers there."""
        ...

    async def start_offboard(self, setpoint: Setpoint) -> None: ...

    async def send(self, setpoint: Setpoint) -> None: ...

    async def say(self, event: Event) -> None:
        """Tells whoever watches the vehicle (STATUSTEXT). Never raises: nothing depends on it."""
        ...

    async def hold(self) -> None:
        """Stops and hovers in the autopilot's own hold mode."""
        ...

    async def land(self) -> None:
        """Lands here; returns when disarmed."""
        ...


class MotionCapture(Protocol):
    """Truth about the vehicle's pose from outside of it."""

    def drain(self) -> Sequence[MocapPose]:
        """The poses since the last call, oldest first."""
        ...


class Rig(NamedTuple):
    """All that a flight needs, opened."""

    vehicle: Vehicle
    camera: StereoCamera
    clock: Clock
    mocap: MotionCapture | None = None
    patient: bool = False
    """The world waits for the companion, so that nothing need be left out for want of time."""


class Endpoints(NamedTuple):
    """Where a simulator that runs as its own process can be reached."""

    mavlink_url: str
    camera_url: str


class Simulator(Protocol):
    """An entry point of the group ``companion.simulators``."""

    def __call__(
        self, request: SimulationRequest
    ) -> AbstractAsyncContextManager[Rig | Endpoints]: ...
