"""The vehicle in the companion's own process: asking for the next frame advances the world."""

import logging
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from companion.kernel.calibration import StereoCalibration
from companion.kernel.clock import let_others_run
from companion.kernel.errors import VehicleError
from companion.kernel.frames import ned_from_hfrd
from companion.kernel.messages import (
    NAN,
    Event,
    FlightMode,
    LandedState,
    MocapPose,
    Setpoint,
    SimulationRequest,
    StereoFrame,
    Telemetry,
)
from companion.kernel.protocols import Rig
from sitl.autopilot.interface import Ack, OffboardSetpoint, Severity
from sitl.build import Simulation, build

logger = logging.getLogger(__name__)

POLL_PERIOD_S = 0.02
READY_LIMIT_S = 20.0
CLIMB_LIMIT_S = 30.0
MODE_LIMIT_S = 2.0
LAND_LIMIT_S = 60.0
HEIGHT_TOLERANCE_M = 0.15
TEXT_LENGTH = 50
"""Characters that a STATUSTEXT holds."""


@asynccontextmanager
async def open_rig(request: SimulationRequest) -> AsyncIterator[Rig]:
    """The entry point ``lockstep`` of the companion's simulators."""
    simulation = build(Path(request.room), request.settings, request.seed, request.camera_rate_hz)
    yield rig_of(simulation)


def rig_of(simulation: Simulation) -> Rig:
    """The simulation as the companion sees it."""
    return Rig(
        LockstepVehicle(simulation),
        LockstepCamera(simulation),
        LockstepClock(simulation),
        LockstepMocap(simulation),
    )


class LockstepClock:
    """Simulated time. Sleeping only lets other tasks run: frames move the world."""

    def __init__(self, simulation: Simulation) -> None:
        self._world = simulation.world

    def now_s(self) -> float:
        return self._world.time_s

    async def sleep(self, duration_s: float) -> None:
        await let_others_run()


class _Opened:
    """Nothing to open or close."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        return None


class LockstepMocap:
    """Truth, straight from the world."""

    def __init__(self, simulation: Simulation) -> None:
        self._poses = simulation.world.mocap

    def drain(self) -> Sequence[MocapPose]:
        poses = tuple(self._poses)
        self._poses.clear()
        return poses


class LockstepCamera(_Opened):
    """Renders the pair at each exposure; no frame is late or dropped unless faults make it so."""

    frames_dropped = 0

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    @property
    def calibration(self) -> StereoCalibration:
        return self._simulation.camera.calibration

    async def frames(self) -> AsyncIterator[StereoFrame]:
        while True:
            await let_others_run()
            frame = self._simulation.next_frame()
            if frame is not None:
                yield frame


class LockstepVehicle(_Opened):
    """The autopilot without a link. Verbs run the world until telemetry would confirm them."""

    def __init__(self, simulation: Simulation) -> None:
        self._world = simulation.world
        self._autopilot = simulation.world.autopilot

    def telemetry(self) -> Telemetry:
        estimate, status = self._autopilot.estimate, self._autopilot.status
        return Telemetry(
            stamp_ns=round(estimate.time_s * 1e9),
            position_ned_m=estimate.position_ned_m,
            velocity_ned_m_s=estimate.velocity_ned_m_s,
            roll_rad=estimate.roll_rad,
            pitch_rad=estimate.pitch_rad,
            yaw_rad=estimate.yaw_rad,
            yaw_rate_rad_s=estimate.rates_frd_rad_s[2],
            armed=status.armed,
            flight_mode=status.mode,
            landed_state=status.landed_state,
            battery_norm=status.battery_norm,
            connected=True,
        )

    async def arm(self) -> None:
        with suppress(VehicleError):  # arming then says what is missing
            await self._run_until(
                lambda: self._autopilot.status.ready_to_arm, READY_LIMIT_S, "ready"
            )
        self._accept(self._autopilot.arm(), "arm")

    async def take_off(self, height_m: float) -> None:
        await self.arm()
        self._accept(self._autopilot.take_off(height_m), "take off")
        await self._run_until(lambda: self._hovers_at(height_m), CLIMB_LIMIT_S, "at height")

    async def start_offboard(self, setpoint: Setpoint) -> None:
        await self.send(setpoint)
        self._accept(self._autopilot.set_mode(FlightMode.OFFBOARD), "start offboard")
        await self._run_until_mode(FlightMode.OFFBOARD)

    async def send(self, setpoint: Setpoint) -> None:
        forward, right, down = setpoint.velocity_hfrd_m_s
        north, east = ned_from_hfrd(forward, right, self._autopilot.estimate.yaw_rad)
        self._autopilot.set_offboard_setpoint(
            OffboardSetpoint(
                velocity_ned_m_s=(north, east, down),
                yaw_rad=NAN,
                yaw_rate_rad_s=setpoint.yaw_rate_rad_s,
            )
        )

    async def say(self, event: Event) -> None:
        severity = Severity.__members__.get(event.severity.upper(), Severity.INFO)
        self._autopilot.announce(severity, event.text[:TEXT_LENGTH])

    async def hold(self) -> None:
        self._accept(self._autopilot.set_mode(FlightMode.HOLD), "hold")
        await self._run_until_mode(FlightMode.HOLD)

    async def land(self) -> None:
        if not self._autopilot.status.armed:
            return
        self._accept(self._autopilot.land(), "land")
        await self._run_until(lambda: not self._autopilot.status.armed, LAND_LIMIT_S, "disarmed")

    def _hovers_at(self, height_m: float) -> bool:
        error_m = abs(height_m + self._autopilot.estimate.position_ned_m[2])
        status = self._autopilot.status
        in_air = status.landed_state is LandedState.IN_AIR
        return in_air and status.mode is FlightMode.HOLD and error_m < HEIGHT_TOLERANCE_M

    def _accept(self, ack: Ack, what: str) -> None:
        if ack is not Ack.ACCEPTED:
            texts = [text.text for text in self._autopilot.drain_status_texts()]
            why = "; ".join(texts[-3:]) or "no text"
            raise VehicleError(f"{what}: {ack.name.lower()} by the autopilot ({why})")

    async def _run_until_mode(self, mode: FlightMode) -> None:
        await self._run_until(lambda: self._autopilot.status.mode is mode, MODE_LIMIT_S, mode.value)

    async def _run_until(self, done: Callable[[], bool], limit_s: float, what: str) -> None:
        deadline_s = self._world.time_s + limit_s
        while not done():
            if self._world.time_s > deadline_s:
                raise VehicleError(f"not {what} within {limit_s:.0f} s")
            self._world.advance_to(self._world.time_s + POLL_PERIOD_S)
            await let_others_run()
