"""The coroutines of a flight. They only move data; what to do is decided in plain functions."""

import logging
from collections.abc import Callable

from companion.flightlog import FlightLogWriter, Topic
from companion.kernel.clock import Clock
from companion.kernel.errors import CompanionError, VehicleError
from companion.kernel.messages import (
    Event,
    FlightMode,
    Phase,
    Setpoint,
    StereoFrame,
    Telemetry,
)
from companion.kernel.protocols import Rig
from companion.pipeline import Pipeline, Step
from companion.safety import Reaction, SafetySettings, react_to_age
from companion.supervisor import Supervisor
from companion.truth import TruthRecorder

logger = logging.getLogger(__name__)

WATCH_PERIOD_S = 0.1
LEFT_OFFBOARD_LIMIT_S = 3.0
"""Heartbeats come at 1 Hz, and PX4 returns to offboard by itself when setpoints resume."""

Observer = Callable[[Step, Pipeline], None]


class Heartbeat:
    """What `fly` leaves for `watch`: when it last had a percept, and when telemetry moved."""

    def __init__(self, now_s: float) -> None:
        self.percept_s = now_s
        self.telemetry_s = now_s
        self.telemetry_stamp_ns = -1
        self.flying = False
        """Percepts are expected."""

    def saw_telemetry(self, telemetry: Telemetry, now_s: float) -> None:
        if telemetry.stamp_ns != self.telemetry_stamp_ns:
            self.telemetry_stamp_ns = telemetry.stamp_ns
            self.telemetry_s = now_s


async def fly(
    rig: Rig,
    pipeline: Pipeline,
    log: FlightLogWriter,
    truth: TruthRecorder,
    heartbeat: Heartbeat,
    observer: Observer,
) -> None:
    """Frame by frame until the plan is flown.

    Raises VehicleError when the autopilot is no longer ours or safety wants to land, CompanionError
    when a frame cannot be worked on.
    """
    authority = Authority()
    async for frame in rig.camera.frames():
        telemetry = rig.vehicle.telemetry()
        heartbeat.saw_telemetry(telemetry, rig.clock.now_s())
        step = _step(pipeline, frame, telemetry)
        if step.decision.phase is Phase.DONE:
            return
        authority.check(telemetry, frame.stamp_ns)
        if step.verdict.reaction is Reaction.LAND:
            raise VehicleError(f"landing: {step.verdict.reason}")
        await rig.vehicle.send(step.verdict.setpoint)
        heartbeat.percept_s = rig.clock.now_s()
        _write(log, frame, telemetry, step)
        truth.record(step.decision.phase)
        observer(step, pipeline)
    raise VehicleError("the camera has no more frames before the plan is flown")


def _step(pipeline: Pipeline, frame: StereoFrame, telemetry: Telemetry) -> Step:
    """One frame on; whatever goes wrong in there, the vehicle has to come down."""
    try:
        return pipeline.step(frame, telemetry)
    except CompanionError:
        raise
    except Exception as error:
        logger.exception("on the frame of %.2f s", frame.stamp_ns * 1e-9)
        said = f"{type(error).__name__}: {error}"
        raise CompanionError(f"perceiving and deciding failed: {said}") from error


async def watch(
    rig: Rig, log: FlightLogWriter, heartbeat: Heartbeat, settings: SafetySettings
) -> None:
    """Stops, holds and at last lands when percepts or telemetry grow stale."""
    last = Reaction.FLY
    while True:
        await rig.clock.sleep(WATCH_PERIOD_S)
        now_s = rig.clock.now_s()
        heartbeat.saw_telemetry(rig.vehicle.telemetry(), now_s)
        ages_s = {
            "frame": now_s - heartbeat.percept_s,
            "telemetry": now_s - heartbeat.telemetry_s,
        }
        what = max(ages_s, key=lambda name: ages_s[name])
        reaction = react_to_age(ages_s[what], settings)
        if reaction is not last:
            text = f"no new {what} for {ages_s[what]:.1f} s: {reaction.name.lower()}"
            logger.warning(text)
            stamp_ns = rig.vehicle.telemetry().stamp_ns
            log.write(Topic.EVENT, Event(stamp_ns=stamp_ns, severity="warning", text=text))
        if reaction is Reaction.STOP:
            await rig.vehicle.send(Setpoint(stamp_ns=rig.vehicle.telemetry().stamp_ns))
        elif reaction is Reaction.HOLD and last is not Reaction.HOLD:
            await rig.vehicle.hold()
        elif reaction is Reaction.LAND:
            raise VehicleError(f"no new {what} for {ages_s[what]:.1f} s: landing")
        last = reaction


async def pulse(
    clock: Clock,
    newest: Callable[[], Heartbeat],
    settings: SafetySettings,
    supervisor: Supervisor,
) -> None:
    """Keeps the service manager's watchdog quiet while the flight moves on.

    Percepts that stay away for longer than it takes to land do not; nor does a blocked loop.
    """
    while True:
        heartbeat = newest()
        age_s = clock.now_s() - heartbeat.percept_s
        if not heartbeat.flying or react_to_age(age_s, settings) is not Reaction.LAND:
            supervisor.alive()
        await clock.sleep(WATCH_PERIOD_S)


class Authority:
    """Whether the autopilot still obeys: armed and in offboard mode, but for short lapses."""

    def __init__(self) -> None:
        self._lost_since_ns: int | None = None

    def check(self, telemetry: Telemetry, stamp_ns: int) -> None:
        """Raises VehicleError after LEFT_OFFBOARD_LIMIT_S without authority."""
        if telemetry.armed and telemetry.flight_mode is FlightMode.OFFBOARD:
            self._lost_since_ns = None
            return
        if self._lost_since_ns is None:
            self._lost_since_ns = stamp_ns
        if (stamp_ns - self._lost_since_ns) * 1e-9 > LEFT_OFFBOARD_LIMIT_S:
            state = telemetry.flight_mode.value if telemetry.armed else "disarmed"
            raise VehicleError(f"the autopilot left offboard mode: {state}")


def _write(log: FlightLogWriter, frame: StereoFrame, telemetry: Telemetry, step: Step) -> None:
    log.write_frame(frame)
    log.write(Topic.PERCEPT, step.percept)
    if step.mono_map is not None:
        log.write(Topic.MAP, step.mono_map)
    log.write(Topic.DECISION, step.decision)
    log.write(Topic.SETPOINT, step.verdict.setpoint)
    log.write(Topic.TELEMETRY, telemetry, log_time_ns=frame.stamp_ns)
