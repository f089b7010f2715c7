"""A flight as a user asks for it: plan in, log folder with summary out."""

import asyncio
import logging
import shutil
import signal
from collections.abc import Coroutine, Sequence
from pathlib import Path

import msgspec

from companion import __version__
from companion.app import Flight, Start, start_of
from companion.flightlog import FlightLogWriter, FlightMetadata
from companion.kernel.clock import wall_s
from companion.kernel.errors import CompanionError, VehicleError
from companion.kernel.messages import SimulationRequest
from companion.kernel.protocols import Rig
from companion.logfolder import (
    KILLED,
    LOG_NAME,
    close_interrupted,
    interrupted_flight,
    reserve_summary,
    write_summary,
)
from companion.loops import Observer
from companion.memory import MODEL_NAME, ModelKeeper, has_model, recall
from companion.modelfile import load_dictionary
from companion.pipeline import Pipeline, Step
from companion.plan import Plan, room_path
from companion.rigs import needs_room, open_rig
from companion.summary import FlightFacts, Summary, summarise
from companion.supervisor import Supervisor
from companion.threads import use_one_thread
from companion.vision.textons import TextonDictionary

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)

logger = logging.getLogger(__name__)


class FlightOrder(msgspec.Struct, frozen=True, kw_only=True):
    """What to fly, with what, how fast and where to write it down."""

    plan: Plan
    plan_path: Path
    vehicle: str = "sitl"
    camera: str = "sitl"
    speed: float = 10.0
    log_dir: Path
    model: Path | None = None
    """What an earlier flight learned: a file, a flight's folder or a folder of flights."""
    resume: bool = False
    """Go on with the flight that was interrupted, if it was: ``log_dir`` lies beside its folder."""


class _Record:
    """What is known of a flight once its devices are gone."""

    def __init__(self, supervisor: Supervisor | None = None) -> None:
        self.supervisor = supervisor or Supervisor()
        self.facts = FlightFacts()
        self.pipeline: Pipeline | None = None
        """None until the log is open: before that, there is nothing to leave."""
        self.keeper: ModelKeeper | None = None
        self.over = False
        """Landed; only the devices are left to close."""


async def fly_plan(
    order: FlightOrder,
    observer: Observer,
    stop_signals: Sequence[signal.Signals] = STOP_SIGNALS,
    supervisor: Supervisor | None = None,
) -> Summary:
    """Flies; always leaves the log, the model and summary.json, also when the flight fails.

    Raises CompanionError when nothing could fly, and takes the log folder away then; a failed or
    aborted flight is in the summary. Only a process's main thread can listen to ``stop_signals``.
    """
    record = _Record(supervisor)
    flying = _run_until_stopped(_open_and_fly(order, observer, record), record, stop_signals)
    try:
        return await _summarised(order, record, flying)
    except CompanionError:
        if record.pipeline is None:
            shutil.rmtree(order.log_dir, ignore_errors=True)
        raise


async def fly_rig(order: FlightOrder, rig: Rig, observer: Observer) -> Summary:
    """``fly_plan`` with devices that somebody else has opened, and closes."""
    record = _Record()
    return await _summarised(order, record, _log_and_fly(order, rig, observer, record))


async def _summarised(
    order: FlightOrder, record: _Record, flying: Coroutine[None, None, None]
) -> Summary:
    """Flies, and leaves what a flight leaves once it has begun, also when it fails."""
    try:
        await flying
    except CompanionError as error:
        if record.pipeline is None:
            raise
        record.facts.outcome, record.facts.reason = "failed", str(error)
    return _leave(order, record)


async def _run_until_stopped(
    flying: Coroutine[None, None, None], record: _Record, stop_signals: Sequence[signal.Signals]
) -> None:
    """Runs it so that the first of ``stop_signals`` cancels it. Raises CompanionError."""
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(flying)
    received: list[signal.Signals] = []

    def stop(number: signal.Signals) -> None:
        doing = "landing" if record.pipeline and not record.over else "ending"
        if received or record.over:
            logger.warning("%s: already %s", number.name, doing)
            return
        logger.warning("%s: %s", number.name, doing)
        received.append(number)
        task.cancel()

    for number in stop_signals:
        loop.add_signal_handler(number, stop, number)
    try:
        await task
    except asyncio.CancelledError:
        if not received:
            raise
        reason = f"stopped by {received[0].name}"
        if record.pipeline is None:
            raise CompanionError(f"{reason} before take-off") from None
        record.facts.outcome, record.facts.reason = "aborted", reason
    finally:
        for number in stop_signals:
            loop.remove_signal_handler(number)


async def _open_and_fly(order: FlightOrder, observer: Observer, record: _Record) -> None:
    async with (
        open_rig(order.vehicle, order.camera, order.speed, _request(order)) as rig,
        rig.camera,
        rig.vehicle,
    ):
        await _log_and_fly(order, rig, observer, record)


async def _log_and_fly(order: FlightOrder, rig: Rig, observer: Observer, record: _Record) -> None:
    use_one_thread()
    pipeline = Pipeline(order.plan, rig.camera.calibration, _dictionary(order))
    start = _recall_all(order, rig, pipeline)
    keeper = ModelKeeper(
        order.log_dir / MODEL_NAME,
        rig.camera.calibration,
        order.plan.log.model_period_s,
        rig.patient,
    )
    with _open_log(order, rig) as log:
        killed = FlightFacts(reason=KILLED)
        reserve_summary(
            order.log_dir, summarise(order.plan, order.plan_path.stem, pipeline, killed)
        )
        record.pipeline, record.keeper = pipeline, keeper
        observers = _all_of(observer, record.facts, keeper, record.supervisor)
        await _fly(Flight(rig, pipeline, log, observers, start, record.supervisor), record)


def _recall_all(order: FlightOrder, rig: Rig, pipeline: Pipeline) -> Start:
    """Brings back what was known; says how the flight begins. Raises CompanionError."""
    interrupted = interrupted_flight(order.log_dir.parent, order.log_dir) if order.resume else None
    start = start_of(rig.vehicle.telemetry(), order.resume)
    if interrupted is not None and start is Start.TAKE_OFF:
        close_interrupted(interrupted)
        raise VehicleError(
            f"{interrupted}: interrupted, and the vehicle has landed alone; start again to fly"
        )
    source = interrupted if interrupted is not None and has_model(interrupted) else order.model
    if source is not None:
        recalled = recall(source, rig.camera.calibration)
        recalled.teach(pipeline.learner)
        pipeline.flown_s = recalled.saved.flown_s if source is interrupted else 0.0
        logger.info("flying on with %s", recalled.path)
    return start


async def _fly(flight: Flight, record: _Record) -> None:
    facts = record.facts
    began_wall_s = wall_s()
    try:
        await flight.run()
        facts.outcome = "flown"
    finally:
        record.over = True
        facts.wall_s = wall_s() - began_wall_s
        facts.sim_s = flight.flown_s
        facts.frames_dropped = flight.rig.camera.frames_dropped
        facts.camera_faults = flight.pipeline.health.n_named
        facts.collisions = flight.truth.collisions
        facts.minimum_clearance_m = flight.truth.minimum_clearance_m
        facts.distance_flown_m = flight.truth.distance_flown_m
        facts.truth = flight.truth.accounts


def _request(order: FlightOrder) -> SimulationRequest | None:
    if not needs_room(order.vehicle):
        return None
    return SimulationRequest(
        room=str(room_path(order.plan, order.plan_path)),
        seed=order.plan.seed,
        speed=order.speed,
        camera_rate_hz=order.plan.camera.rate_hz,
        log_dir=str(order.log_dir),
        settings=order.plan.sitl,
    )


def _dictionary(order: FlightOrder) -> TextonDictionary | None:
    path = order.plan.learner.dictionary
    return load_dictionary(order.plan_path.parent / path) if path else None


def _open_log(order: FlightOrder, rig: Rig) -> FlightLogWriter:
    metadata = FlightMetadata(
        plan=msgspec.to_builtins(order.plan),
        seed=order.plan.seed,
        version=__version__,
        calibration=rig.camera.calibration,
    )
    return FlightLogWriter(
        order.log_dir / LOG_NAME, metadata, order.plan.log.images, patient=rig.patient
    )


def _all_of(
    observer: Observer, facts: FlightFacts, keeper: ModelKeeper, supervisor: Supervisor
) -> Observer:
    """Everybody who looks at each frame, the one who ordered the flight last."""

    def observe(step: Step, pipeline: Pipeline) -> None:
        facts.frames += 1
        keeper.offer(step.percept.stamp_ns, pipeline.learner, pipeline.flown_s)
        decision = step.decision
        supervisor.status(
            f"{decision.phase.value}, {pipeline.flown_s:.0f} s flown on {decision.cue.value}, "
            f"{decision.turns} turns, {decision.overrides} overrides"
        )
        observer(step, pipeline)

    return observe


def _leave(order: FlightOrder, record: _Record) -> Summary:
    """The learned model and the summary, beside the log."""
    pipeline, facts = record.pipeline, record.facts
    assert pipeline is not None
    assert record.keeper is not None
    try:
        record.keeper.finish(pipeline.learner, pipeline.flown_s)
    except CompanionError as error:
        if facts.outcome == "flown":
            facts.outcome, facts.reason = "failed", str(error)
        else:
            logger.error("%s", error)  # the flight's own error says more
    summary = summarise(order.plan, order.plan_path.stem, pipeline, facts)
    write_summary(order.log_dir, summary)
    return summary
