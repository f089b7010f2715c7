"""The coroutines of a flight. They only move data; what to do is decided in plain functions."""

import logging
from collections.abc import Callable

from companion.flightlog import FlightLogWriter, Topic
from companion.flying.safety import Reaction, SafetySettings, Verdict, react_to_age
from companion.kernel.clock import Clock
from companion.kernel.errors import CompanionError, VehicleError
from companion.kernel.messages import (
    CameraFault,
    Event,
    FlightMode,
    Phase,
    Setpoint,
    StereoFrame,
    Telemetry,
)
from companion.kernel.protocols import Rig, Vehicle
from companion.pipeline import Pipeline, Step
from companion.supervisor import Supervisor
from companion.truth import TruthRecorder

logger = logging.getLogger(__name__)

WATCH_PERIOD_S = 0.1
SILENT_AFTER_S = 0.35
"""Without a frame the camera's silence is named, before anything is done about it."""
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
        step = _step(pipeline, frame, telemetry, rig.clock.now_s())
        if step.decision.phase is Phase.DONE:
            return
        authority.check(telemetry, frame.stamp_ns)
        for event in step.events:
            await announce(rig.vehicle, log, event)
        if step.verdict.reaction is Reaction.LAND:
            raise VehicleError(f"landing: {step.verdict.reason}")
        await _obey(rig.vehicle, step.verdict, authority)
        heartbeat.percept_s = rig.clock.now_s()
        _write(log, frame, telemetry, step)
        truth.record(step.decision.phase)
        observer(step, pipeline)
    raise VehicleError("the camera has no more frames before the plan is flown")


def _step(pipeline: Pipeline, frame: StereoFrame, telemetry: Telemetry, now_s: float) -> Step:
    """One frame on; whatever goes wrong in there, the vehicle has to come down."""
    try:
        return pipeline.step(frame, telemetry, now_s)
    except CompanionError:
        raise
    except Exception as error:
        logger.exception("on the frame of %.2f s", frame.stamp_ns * 1e-9)
        said = f"{type(error).__name__}: {error}"
        raise CompanionError(f"perceiving and deciding failed: {said}") from error


async def announce(vehicle: Vehicle, log: FlightLogWriter, event: Event) -> None:
    """To the log, to the terminal and over the link."""
    logger.log(logging.INFO if event.severity == "info" else logging.WARNING, "%s", event.text)
    log.write(Topic.EVENT, event)
    await vehicle.say(event)


async def _obey(vehicle: Vehicle, verdict: Verdict, authority: "Authority") -> None:
    """Setpoints go on in hold mode, so that whoever watches them sees us alive."""
    if verdict.reaction is Reaction.HOLD and authority.mode is FlightMode.OFFBOARD:
        await vehicle.hold()
        authority.mode = FlightMode.HOLD
    elif verdict.reaction < Reaction.HOLD and authority.mode is FlightMode.HOLD:
        await vehicle.start_offboard(verdict.setpoint)
        authority.mode = FlightMode.OFFBOARD
    await vehicle.send(verdict.setpoint)


async def watch(
    rig: Rig, log: FlightLogWriter, heartbeat: Heartbeat, settings: SafetySettings
) -> None:
    """Stops, holds and at last lands when percepts or telemetry grow stale."""
    last, silent = Reaction.FLY, False
    while True:
        await rig.clock.sleep(WATCH_PERIOD_S)
        now_s = rig.clock.now_s()
        heartbeat.saw_telemetry(rig.vehicle.telemetry(), now_s)
        ages_s = {
            "frame": now_s - heartbeat.percept_s,
            "telemetry": now_s - heartbeat.telemetry_s,
        }
        if silent is not (ages_s["frame"] > SILENT_AFTER_S):
            silent = not silent
            await announce(rig.vehicle, log, _silence(rig.vehicle, ages_s["frame"], silent))
        what = max(ages_s, key=lambda name: ages_s[name])
        reaction = react_to_age(ages_s[what], settings)
        if reaction is not last:
            text = f"no new {what} for {ages_s[what]:.1f} s: {reaction.name.lower()}"
            stamp_ns = rig.vehicle.telemetry().stamp_ns
            event = Event(stamp_ns=stamp_ns, severity="warning", text=text)
            await announce(rig.vehicle, log, event)
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


def _silence(vehicle: Vehicle, age_s: float, silent: bool) -> Event:
    stamp_ns = vehicle.telemetry().stamp_ns
    if not silent:
        return Event(stamp_ns=stamp_ns, severity="info", text="camera: frames again")
    text = f"camera: {CameraFault.NO_FRAMES.value}; stopping (for {age_s:.1f} s)"
    return Event(stamp_ns=stamp_ns, severity="warning", text=text)


class Authority:
    """Whether the autopilot still obeys: armed and in our mode, but for short lapses."""

    def __init__(self) -> None:
        self.mode = FlightMode.OFFBOARD
        """What we asked for last."""
        self._lost_since_ns: int | None = None

    def check(self, telemetry: Telemetry, stamp_ns: int) -> None:
        """Raises VehicleError after LEFT_OFFBOARD_LIMIT_S without authority."""
        if telemetry.armed and telemetry.flight_mode is self.mode:
            self._lost_since_ns = None
            return
        if self._lost_since_ns is None:
            self._lost_since_ns = stamp_ns
        if (stamp_ns - self._lost_since_ns) * 1e-9 > LEFT_OFFBOARD_LIMIT_S:
            state = telemetry.flight_mode.value if telemetry.armed else "disarmed"
            raise VehicleError(f"the autopilot left {self.mode.value} mode: {state}")


def _write(log: FlightLogWriter, frame: StereoFrame, telemetry: Telemetry, step: Step) -> None:
    log.write_frame(frame)
    log.write(Topic.PERCEPT, step.percept)
    if step.mono_map is not None:
        log.write(Topic.MAP, step.mono_map)
    log.write(Topic.DECISION, step.decision)
    if step.health is not None:
        log.write(Topic.HEALTH, step.health)
    if step.drift is not None:
        log.write(Topic.DRIFT, step.drift)
    if step.trust is not None:
        log.write(Topic.TRUST, step.trust)
    log.write(Topic.SETPOINT, step.verdict.setpoint)
    log.write(Topic.TELEMETRY, telemetry, log_time_ns=frame.stamp_ns)
