"""One flight from take-off to landing, whatever happens on the way."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from enum import Enum, auto

from companion.flightlog import FlightLogWriter, Topic
from companion.kernel.errors import CompanionError, LinkError, VehicleError
from companion.kernel.messages import Event, FlightMode, LandedState, Phase, Setpoint, Telemetry
from companion.kernel.protocols import Rig
from companion.loops import Heartbeat, Observer, fly, pulse, watch
from companion.pipeline import Pipeline
from companion.supervisor import Supervisor
from companion.truth import TruthRecorder

logger = logging.getLogger(__name__)

LAND_LIMIT_S = 90.0
"""Wall time; longer than any vehicle's own limit of simulated time."""
LINK_LIMIT_S = 30.0
"""For a lost link to come back, so that the vehicle can still be told to land."""
PILOT_MODES = (FlightMode.MANUAL, FlightMode.ALTITUDE, FlightMode.POSITION)
"""A human has taken over: nothing is commanded any more."""


class Start(Enum):
    """How a flight begins."""

    TAKE_OFF = auto()
    TAKE_OVER = auto()
    """In the air already: only offboard mode is begun."""


def start_of(telemetry: Telemetry, resume: bool) -> Start:
    """Raises VehicleError for a vehicle in the air that is not ours to fly."""
    on_ground = telemetry.landed_state in (LandedState.ON_GROUND, LandedState.UNKNOWN)
    if not telemetry.armed or on_ground:
        return Start.TAKE_OFF
    mode = telemetry.flight_mode
    if mode in PILOT_MODES:
        raise VehicleError(f"a pilot is flying the vehicle ({mode.value} mode); leaving it to them")
    if not resume:
        raise VehicleError(f"the vehicle flies already ({mode.value} mode); --resume takes it over")
    return Start.TAKE_OVER


class Flight:
    """Flies a plan with a rig that is open; keeps the pipeline for the summary."""

    def __init__(
        self,
        rig: Rig,
        pipeline: Pipeline,
        log: FlightLogWriter,
        observer: Observer,
        start: Start = Start.TAKE_OFF,
        supervisor: Supervisor | None = None,
    ) -> None:
        self.rig = rig
        self.pipeline = pipeline
        self.truth = TruthRecorder(rig.mocap, log)
        self.flown_s = 0.0
        """Take-off to landing, on the vehicle's clock."""
        self._heartbeat = Heartbeat(rig.clock.now_s())
        self._plan = pipeline.plan
        self._log = log
        self._observer = observer
        self._start = start
        self._supervisor = supervisor or Supervisor()

    async def run(self) -> None:
        """Takes off, flies the plan, lands. Raises CompanionError; has landed even then."""
        began_ns = self.rig.vehicle.telemetry().stamp_ns
        async with self._pulse():
            try:
                await self._begin()
                await self._fly_and_watch()
                await self._end(began_ns, best_effort=False)
            except LinkError:
                await self._end(began_ns, best_effort=True, link_limit_s=LINK_LIMIT_S)
                raise
            except BaseException:  # an interrupted landing begins again
                await self._end(began_ns, best_effort=True)
                raise

    @asynccontextmanager
    async def _pulse(self) -> AsyncIterator[None]:
        """Tells the service manager, if there is one, that the flight goes on."""
        self._supervisor.ready()
        if not self._supervisor.listens:
            yield
            return
        beating = asyncio.create_task(
            pulse(self.rig.clock, lambda: self._heartbeat, self._plan.safety, self._supervisor),
            name="pulse",
        )
        try:
            yield
        finally:
            beating.cancel()
            await asyncio.wait({beating})

    async def _begin(self) -> None:
        vehicle = self.rig.vehicle
        if self._start is Start.TAKE_OFF:
            await vehicle.take_off(self._plan.behaviour.height_m)
        stamp_ns = vehicle.telemetry().stamp_ns
        if self._start is Start.TAKE_OVER:
            text = f"took over in flight, from {vehicle.telemetry().flight_mode.value} mode"
            self._log.write(Topic.EVENT, Event(stamp_ns=stamp_ns, severity="warning", text=text))
        await vehicle.start_offboard(Setpoint(stamp_ns=stamp_ns))

    async def _fly_and_watch(self) -> None:
        heartbeat = self._heartbeat = Heartbeat(self.rig.clock.now_s())
        heartbeat.flying = True
        try:
            async with asyncio.TaskGroup() as tasks:
                watching = tasks.create_task(
                    watch(self.rig, self._log, heartbeat, self._plan.safety), name="watch"
                )
                await fly(self.rig, self.pipeline, self._log, self.truth, heartbeat, self._observer)
                watching.cancel()
        except* CompanionError as group:
            raise _first(group) from group
        finally:
            heartbeat.flying = False

    async def _end(self, began_ns: int, *, best_effort: bool, link_limit_s: float = 0.0) -> None:
        """Hold and land. When the flight already failed, its error is the one to report."""
        self.truth.begin_landing()
        self._supervisor.stopping()
        try:
            now = await self._telemetry_within(link_limit_s)
            if now.armed and now.flight_mode in PILOT_MODES:
                logger.warning("a pilot has taken over; leaving the vehicle to them")
                return
            await self._hold_and_land()
        except CompanionError as error:
            if not best_effort:
                raise
            logger.error("while landing: %s", error)
        finally:
            self.flown_s = max(0.0, (self._newest_stamp_ns() - began_ns) * 1e-9)
            self.truth.record(Phase.DONE)

    async def _telemetry_within(self, limit_s: float) -> Telemetry:
        """Waits for a lost link this long, by the frames' stamps. Raises LinkError.

        In lockstep it is the frames that let time pass; a camera that is gone as well ends it.
        """
        with suppress(LinkError):
            return self.rig.vehicle.telemetry()
        began_ns = -1
        with suppress(CompanionError, TimeoutError):
            async with asyncio.timeout(max(limit_s, LAND_LIMIT_S)):
                async for frame in self.rig.camera.frames():
                    began_ns = frame.stamp_ns if began_ns < 0 else began_ns
                    if frame.stamp_ns - began_ns >= limit_s * 1e9:
                        break
                    with suppress(LinkError):
                        return self.rig.vehicle.telemetry()
        return self.rig.vehicle.telemetry()

    async def _hold_and_land(self) -> None:
        """The vehicle bounds each verb by its own clock; the timeout is for a stuck adapter."""
        try:
            async with asyncio.timeout(LAND_LIMIT_S):
                with suppress(CompanionError):
                    await self.rig.vehicle.hold()
                await self.rig.vehicle.land()
        except TimeoutError:
            raise VehicleError(f"not landed within {LAND_LIMIT_S:.0f} s") from None

    def _newest_stamp_ns(self) -> int:
        """The autopilot's time; once it is gone, when it was last heard."""
        try:
            return self.rig.vehicle.telemetry().stamp_ns
        except CompanionError:
            return self._heartbeat.telemetry_stamp_ns


def _first(group: BaseExceptionGroup[CompanionError]) -> CompanionError:
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, CompanionError)
    return error
