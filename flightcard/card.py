"""The verbs of a mission test: each returns when the flight confirms it, or says what is wrong.

Limits and durations are seconds of the vehicle's own time. Taking the next camera frame is what
lets time pass, so the same verbs fly a vehicle in lockstep and one in a process of its own.
"""

import asyncio
import math
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, TypeVar

from companion.flight import FlightOrder, fly_rig
from companion.kernel.errors import LinkError, PlanError
from companion.kernel.messages import (
    FlightMode,
    LandedState,
    MocapPose,
    Setpoint,
    StereoFrame,
    Telemetry,
)
from companion.kernel.settings import convert_settings
from companion.summary import Summary
from flightcard.errors import NotMetError
from flightcard.evidence import Evidence, describe_clearance
from flightcard.machines import Machine
from flightcard.order import Order
from sitl.faults import Faults

HOVER_SPEED_M_S = 0.15
HOVER_FOR_S = 1.0
"""How long it must stay slower than that."""
HEARTBEAT_LIMIT_S = 3.0
"""What a heartbeat says may be this old: they come at 1 Hz."""

T = TypeVar("T")


class FlightCard:
    """One open vehicle."""

    def __init__(
        self, machine: Machine, order: Order, evidence: Evidence, runner: asyncio.Runner
    ) -> None:
        self.evidence = evidence
        self.spare_link = machine.spare_link
        """Where a further MAVLink client can speak to the vehicle; None in lockstep."""
        self._machine = machine
        self._rig = machine.rig._replace(mocap=evidence)
        self._order = order
        self._runner = runner
        self._frames = machine.rig.camera.frames()
        self._telemetry = machine.rig.vehicle.telemetry()
        self._frame_stamp_ns = 0
        self._run(machine.inject(order.faults))

    # -- what is known -------------------------------------------------------------------------

    @property
    def telemetry(self) -> Telemetry:
        """What the autopilot says of itself."""
        return self._rig.vehicle.telemetry()

    @property
    def time_s(self) -> float:
        """The vehicle's clock; when its link is silent, the newest frame's stamp."""
        try:
            return self.telemetry.stamp_ns * 1e-9
        except LinkError:
            return self._frame_stamp_ns * 1e-9

    @property
    def path(self) -> list[MocapPose]:
        """The truth, from the start on."""
        return self.evidence.path

    @property
    def texts(self) -> list[str]:
        """All STATUSTEXTs so far."""
        return [text for _, text in self.evidence.texts]

    # -- what it shall do ----------------------------------------------------------------------

    def arm(self) -> None:
        self._run(self._arm())

    def take_off(self, height_m: float = 1.2) -> None:
        """Arms where that was not done, climbs, and hovers."""
        self._run(self._rig.vehicle.take_off(height_m))

    def fly_plan(self) -> Summary:
        """The companion flies the marker's plan from the ground to the ground."""
        plan_path = self._order.plan_path
        if plan_path is None:
            raise PlanError("fly_plan: no plan; name one: @pytest.mark.flight(plan=...)")
        order = FlightOrder(
            plan=self._order.plan, plan_path=plan_path, log_dir=self.evidence.folder
        )
        return self._run(fly_rig(order, self._rig, lambda step, pipeline: self._note()))

    def fly_velocity(
        self,
        duration_s: float,
        *,
        forward_m_s: float = 0.0,
        right_m_s: float = 0.0,
        down_m_s: float = 0.0,
        yaw_rate_rad_s: float = 0.0,
    ) -> None:
        """In offboard mode; then holds."""
        velocity = (forward_m_s, right_m_s, down_m_s)
        self._run(self._fly_velocity(duration_s, velocity, yaw_rate_rad_s))

    def hold(self) -> None:
        self._run(self._rig.vehicle.hold())

    def land(self) -> None:
        """Lands here; returns when disarmed."""
        self._run(self._rig.vehicle.land())

    def inject(self, **faults: object) -> float:
        """Keywords of ``sitl.faults.Faults``; the time they act from."""
        return self._run(self._machine.inject(convert_settings(faults, Faults, "inject")))

    def next_frame(self) -> StereoFrame:
        """The stereo pair of the next exposure."""
        return self._run(self._tick())

    # -- what is waited for --------------------------------------------------------------------

    def run(self, duration_s: float) -> None:
        """Lets time pass."""
        self._run(self._run_for(duration_s))

    def wait_until(
        self, done: Callable[[Telemetry], bool], limit_s: float, what: str = "as wanted"
    ) -> float:
        """The time at which ``done`` was true."""
        self._run(self._wait(lambda: done(self.telemetry), limit_s, what))
        return self.time_s

    def wait_until_hovering(self, limit_s: float = 10.0) -> None:
        """In the air in hold mode, and still for a second."""
        moved_s = self.time_s

        def hovering() -> bool:
            nonlocal moved_s
            now = self.telemetry
            speed_m_s = math.hypot(*now.velocity_ned_m_s)
            still = now.flight_mode is FlightMode.HOLD and speed_m_s < HOVER_SPEED_M_S
            if not still or now.landed_state is not LandedState.IN_AIR:
                moved_s = self.time_s
            return self.time_s >= moved_s + HOVER_FOR_S

        self._run(self._wait(hovering, limit_s, "hovering"))

    def wait_until_disarmed(self, limit_s: float = 60.0) -> float:
        """For landings that the autopilot itself decided on."""
        return self.wait_until(lambda now: not now.armed, limit_s, "disarmed")

    def wait_until_said(self, text: str, limit_s: float = 10.0) -> float:
        """The time of the first STATUSTEXT with ``text`` in it, now or before."""

        def said() -> list[float]:
            return [time_s for time_s, words in self.evidence.texts if text in words]

        self._run(self._wait(lambda: bool(said()), limit_s, f"told {text!r}"))
        return said()[0]

    # -- what is expected ----------------------------------------------------------------------

    def expect_clearance_m(self, least_m: float) -> None:
        """The hull has kept at least this far from walls, ceiling and furniture in flight."""
        nearest = self.evidence.nearest
        if nearest is None:
            raise NotMetError("clearance: nothing has flown yet")
        if nearest.truth_clearance_m < least_m:
            raise NotMetError(f"clearance of {least_m:g} m not kept: {describe_clearance(nearest)}")

    def expect_no_collision(self) -> None:
        count = self.path[-1].truth_collisions if self.path else 0
        if count:
            raise NotMetError(f"{count} collisions; least clearance: {self._nearest_text()}")

    def close(self) -> None:
        self._runner.run(self._frames.aclose())

    # -- how it is done ------------------------------------------------------------------------

    def _run(self, verb: Coroutine[Any, Any, T]) -> T:
        try:
            return self._runner.run(self._watched(verb))
        finally:
            self._note()

    async def _watched(self, verb: Coroutine[Any, Any, T]) -> T:
        """The verb, or what the vehicle's process died of meanwhile."""
        if self._machine.watch is None:
            return await verb
        doing = asyncio.create_task(verb)
        watching = asyncio.create_task(self._machine.watch())
        try:
            await asyncio.wait({doing, watching}, return_when=asyncio.FIRST_COMPLETED)
            return watching.result() if watching.done() else doing.result()
        finally:
            for task in (doing, watching):
                task.cancel()
            await asyncio.wait({doing, watching})

    def _note(self) -> None:
        """A link that has gone is the verb's to report."""
        with suppress(LinkError):
            self._telemetry = self._rig.vehicle.telemetry()
        self.evidence.note(self._telemetry, self._machine.texts())

    async def _tick(self) -> StereoFrame:
        """To the next frame."""
        frame = await anext(self._frames)
        self._frame_stamp_ns = frame.stamp_ns
        self._note()
        return frame

    async def _arm(self) -> None:
        await self._rig.vehicle.arm()
        await self._wait(lambda: self.telemetry.armed, HEARTBEAT_LIMIT_S, "armed")

    async def _run_for(self, duration_s: float) -> None:
        end_s = self.time_s + duration_s
        while self.time_s < end_s:
            await self._tick()

    async def _wait(self, done: Callable[[], bool], limit_s: float, what: str) -> None:
        end_s = self.time_s + limit_s
        while not done():
            if self.time_s > end_s:
                raise NotMetError(f"not {what} within {limit_s:g} s; {_describe(self.telemetry)}")
            await self._tick()

    async def _fly_velocity(
        self, duration_s: float, velocity_hfrd_m_s: tuple[float, float, float], yaw_rate: float
    ) -> None:
        vehicle = self._rig.vehicle

        def setpoint() -> Setpoint:
            return Setpoint(
                stamp_ns=self.telemetry.stamp_ns,
                velocity_hfrd_m_s=velocity_hfrd_m_s,
                yaw_rate_rad_s=yaw_rate,
            )

        await vehicle.start_offboard(setpoint())
        end_s = self.time_s + duration_s
        while self.time_s < end_s:
            await self._tick()
            await vehicle.send(setpoint())
        await vehicle.hold()

    def _nearest_text(self) -> str:
        nearest = self.evidence.nearest
        return describe_clearance(nearest) if nearest else "unknown"


def _describe(now: Telemetry) -> str:
    north_m, east_m, down_m = now.position_ned_m
    armed = "armed" if now.armed else "disarmed"
    return (
        f"now {armed}, {now.flight_mode.value}, {now.landed_state.value}, {north_m:.2f} m north, "
        f"{east_m:.2f} m east of home, {-down_m:.2f} m above it"
    )
