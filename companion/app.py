"""One flight from take-off to landing, whatever happens on the way."""

import asyncio
import logging
from contextlib import suppress

from companion.flightlog import FlightLogWriter
from companion.kernel.errors import CompanionError, VehicleError
from companion.kernel.messages import FlightMode, Phase, Setpoint
from companion.kernel.protocols import Rig
from companion.loops import Heartbeat, Observer, fly, watch
from companion.pipeline import Pipeline
from companion.truth import TruthRecorder

logger = logging.getLogger(__name__)

LAND_LIMIT_S = 90.0
"""Wall time; longer than any vehicle's own limit of simulated time."""
PILOT_MODES = (FlightMode.MANUAL, FlightMode.ALTITUDE, FlightMode.POSITION)
"""A human has taken over: nothing is commanded any more."""


class Flight:
    """Flies a plan with a rig that is open; keeps the pipeline for the summary."""

    def __init__(
        self, rig: Rig, pipeline: Pipeline, log: FlightLogWriter, observer: Observer
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

    async def run(self) -> None:
        """Takes off, flies the plan, lands. Raises CompanionError; has landed even then."""
        vehicle = self.rig.vehicle
        began_ns = vehicle.telemetry().stamp_ns
        try:
            await vehicle.take_off(self._plan.behaviour.height_m)
            await vehicle.start_offboard(Setpoint(stamp_ns=vehicle.telemetry().stamp_ns))
            await self._fly_and_watch()
            await self._end(began_ns, best_effort=False)
        except BaseException:  # an interrupted landing begins again
            await self._end(began_ns, best_effort=True)
            raise

    async def _fly_and_watch(self) -> None:
        heartbeat = self._heartbeat = Heartbeat(self.rig.clock.now_s())
        try:
            async with asyncio.TaskGroup() as tasks:
                watching = tasks.create_task(
                    watch(self.rig, self._log, heartbeat, self._plan.safety), name="watch"
                )
                await fly(self.rig, self.pipeline, self._log, self.truth, heartbeat, self._observer)
                watching.cancel()
        except* CompanionError as group:
            raise _first(group) from group

    async def _end(self, began_ns: int, *, best_effort: bool) -> None:
        """Hold and land. When the flight already failed, its error is the one to report."""
        self.truth.begin_landing()
        try:
            now = self.rig.vehicle.telemetry()
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
