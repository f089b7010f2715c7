"""The vehicle in the companion's own process: asking for the next frame advances the world."""

import logging
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from companion.kernel.attempts import attempt
from companion.kernel.calibration import StereoCalibration
from companion.kernel.clock import let_others_run
from companion.kernel.errors import LinkError, VehicleError
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
from sitl.lockstep_link import CARRY_PERIOD_S, LockstepLink

logger = logging.getLogger(__name__)

POLL_PERIOD_S = CARRY_PERIOD_S
READY_LIMIT_S = 20.0
CLIMB_LIMIT_S = 30.0
MODE_LIMIT_S = 2.0
LAND_LIMIT_S = 60.0
HEIGHT_TOLERANCE_M = 0.15
ASKED_TIMES = 12
ANSWER_LIMIT_S = 0.5
"""As MAVSDK, and the companion's adapter on it: what is not answered is sent again."""
OFFBOARD_TRIES = 3
"""The command may overtake the first setpoint, and is refused then."""
TEXT_LENGTH = 50
"""Characters that a STATUSTEXT holds."""


@asynccontextmanager
async def open_rig(request: SimulationRequest) -> AsyncIterator[Rig]:
    """The entry point ``lockstep`` of the companion's simulators."""
    simulation = build(Path(request.room), request.settings, request.seed, request.camera_rate_hz)
    yield rig_of(simulation)


def rig_of(simulation: Simulation) -> Rig:
    """The simulation as the companion sees it."""
    vehicle = LockstepVehicle(simulation)
    return Rig(
        vehicle,
        LockstepCamera(simulation, vehicle.link),
        LockstepClock(simulation),
        LockstepMocap(simulation),
        patient=True,
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

    def __init__(self, simulation: Simulation, link: LockstepLink) -> None:
        self._simulation = simulation
        self._link = link

    @property
    def calibration(self) -> StereoCalibration:
        return self._simulation.camera.calibration

    async def frames(self) -> AsyncGenerator[StereoFrame, None]:
        while True:
            await let_others_run()
            self._carry()
            frame = self._simulation.next_frame()
            if frame is not None:
                yield frame

    def _carry(self) -> None:
        """Lets the link work until the exposure, where it takes any time at all."""
        world = self._simulation.world
        last_s = self._simulation.next_exposure_s - 1.5 * CARRY_PERIOD_S
        while self._link.impaired and world.time_s < last_s:
            world.advance_to(world.time_s + CARRY_PERIOD_S)
            self._link.carry()


class LockstepVehicle(_Opened):
    """The autopilot without MAVLink. Verbs run the world until telemetry confirms them."""

    def __init__(self, simulation: Simulation) -> None:
        self._world = simulation.world
        self._autopilot = simulation.world.autopilot
        self.link = LockstepLink(
            self._world.link, lambda: self._world.time_s, self._measure, self._deliver
        )

    def telemetry(self) -> Telemetry:
        return self.link.telemetry()

    async def arm(self) -> None:
        with suppress(VehicleError):  # arming then says what is missing
            await self._run_until(
                lambda _: self._autopilot.status.ready_to_arm, READY_LIMIT_S, "ready"
            )
        await self._ask(self._autopilot.arm, "arm")

    async def take_off(self, height_m: float) -> None:
        await self.arm()
        await self._ask(lambda: self._autopilot.take_off(height_m), "take off")
        await self._run_until(lambda now: _hovers(now, height_m), CLIMB_LIMIT_S, "at height")

    async def start_offboard(self, setpoint: Setpoint) -> None:
        await self.send(setpoint)
        await attempt(OFFBOARD_TRIES, VehicleError, self._start_offboard)

    async def send(self, setpoint: Setpoint) -> None:
        self.link.send(setpoint)

    async def hold(self) -> None:
        self.link.stand_still()
        await self._ask(lambda: self._autopilot.set_mode(FlightMode.HOLD), "hold")
        self.link.rest()
        await self._run_until_mode(FlightMode.HOLD)

    async def land(self) -> None:
        if not self.telemetry().armed:
            return
        self.link.stand_still()
        await self._ask(self._autopilot.land, "land")
        self.link.rest()
        await self._run_until(lambda now: not now.armed, LAND_LIMIT_S, "disarmed")

    async def _start_offboard(self) -> None:
        await self._ask(lambda: self._autopilot.set_mode(FlightMode.OFFBOARD), "start offboard")
        await self._run_until_mode(FlightMode.OFFBOARD)

    def _measure(self) -> Telemetry:
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

    def _deliver(self, setpoint: Setpoint) -> None:
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

    async def _ask(self, command: Callable[[], Ack], what: str) -> None:
        """Raises VehicleError when it is refused, LinkError when no answer comes."""
        if not self.link.impaired:
            self._accept(command(), what)
            return
        ack: Ack | None = None
        for _ in range(ASKED_TIMES):
            there_s, back_s = (self.link.conditions.delays_s() for _ in range(2))
            if there_s:
                await self._run_for(min(there_s))
                ack = command() if ack is None else ack  # repetitions are answered, not obeyed
                if back_s:
                    await self._run_for(min(back_s))
                    self._accept(ack, what)
                    return
            await self._run_for(ANSWER_LIMIT_S)
        raise LinkError(f"{what}: no answer from the autopilot")

    def _accept(self, ack: Ack, what: str) -> None:
        if ack is not Ack.ACCEPTED:
            texts = [text.text for text in self._autopilot.drain_status_texts()]
            why = "; ".join(texts[-3:]) or "no text"
            raise VehicleError(f"{what}: {ack.name.lower()} by the autopilot ({why})")

    async def _run_until_mode(self, mode: FlightMode) -> None:
        await self._run_until(lambda now: now.flight_mode is mode, MODE_LIMIT_S, mode.value)

    async def _run_until(
        self, done: Callable[[Telemetry], bool], limit_s: float, what: str
    ) -> None:
        deadline_s = self._world.time_s + limit_s
        while not done(self.telemetry()):
            if self._world.time_s > deadline_s:
                raise VehicleError(f"not {what} within {limit_s:.0f} s")
            await self._run_for(POLL_PERIOD_S)

    async def _run_for(self, duration_s: float) -> None:
        end_s, half_step_s = self._world.time_s + duration_s, 0.5 / self._world.physics_hz
        while self._world.time_s < end_s - half_step_s:
            self._world.advance_to(min(end_s, self._world.time_s + POLL_PERIOD_S))
            if self.link.impaired:
                self.link.carry()
            await let_others_run()


def _hovers(now: Telemetry, height_m: float) -> bool:
    error_m = abs(height_m + now.position_ned_m[2])
    in_air = now.landed_state is LandedState.IN_AIR
    return in_air and now.flight_mode is FlightMode.HOLD and error_m < HEIGHT_TOLERANCE_M
