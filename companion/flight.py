"""A flight as a user asks for it: plan in, log folder with summary out."""

import asyncio
import logging
import shutil
import signal
from collections.abc import Coroutine, Sequence
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from companion import __version__
from companion.app import Flight
from companion.flightlog import FlightLogWriter, FlightMetadata
from companion.kernel.clock import wall_s
from companion.kernel.errors import CompanionError
from companion.kernel.messages import SimulationRequest
from companion.kernel.protocols import Rig
from companion.loops import Observer
from companion.modelfile import load_dictionary, save_model
from companion.pipeline import Pipeline, Step
from companion.plan import Plan, room_path
from companion.rigs import needs_room, open_rig
from companion.summary import FlightFacts, Summary, summarise
from companion.threads import use_one_thread

LOG_NAME = "flight.mcap"
MODEL_NAME = "model.npz"
SUMMARY_NAME = "summary.json"
SUMMARY_BYTES = 4096
"""Taken on the disk before take-off, so that a disk that fills up in flight still gets the summary;
a companion that is killed leaves the one written then.
"""
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


def new_log_dir(parent: Path, plan: Plan, plan_path: Path) -> Path:
    """``parent/<stamp>-<plan>-<seed>``, made here. Raises CompanionError."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    stem = f"{stamp}-{plan_path.stem}-{plan.seed}"
    for suffix in ("", *(f"-{count}" for count in range(2, 100))):
        path = parent / (stem + suffix)
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise CompanionError(f"{path}: cannot be made: {error.strerror}") from error
        return path
    raise CompanionError(f"{parent / stem}: too many flights within one second")


class _Record:
    """What is known of a flight once its devices are gone."""

    def __init__(self) -> None:
        self.facts = FlightFacts()
        self.pipeline: Pipeline | None = None
        """None until the log is open: before that, there is nothing to leave."""
        self.over = False
        """Landed; only the devices are left to close."""


async def fly_plan(
    order: FlightOrder, observer: Observer, stop_signals: Sequence[signal.Signals] = STOP_SIGNALS
) -> Summary:
    """Flies; always leaves the log, the model and summary.json, also when the flight fails.

    Raises CompanionError when nothing could fly, and takes the log folder away then; a failed or
    aborted flight is in the summary. Only a process's main thread can listen to ``stop_signals``.
    """
    record = _Record()
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
    assert record.pipeline is not None
    return _leave(order, record.pipeline, record.facts)


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
    pipeline = _pipeline(order, rig)
    with _open_log(order, rig) as log:
        _reserve_summary(order, pipeline)
        record.pipeline = pipeline
        await _fly(Flight(rig, pipeline, log, _counting(observer, record.facts)), record)


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


def _pipeline(order: FlightOrder, rig: Rig) -> Pipeline:
    path = order.plan.learner.dictionary
    dictionary = load_dictionary(order.plan_path.parent / path) if path else None
    return Pipeline(order.plan, rig.camera.calibration, dictionary)


def _open_log(order: FlightOrder, rig: Rig) -> FlightLogWriter:
    metadata = FlightMetadata(
        plan=msgspec.to_builtins(order.plan),
        seed=order.plan.seed,
        version=__version__,
        calibration=rig.camera.calibration,
    )
    return FlightLogWriter(order.log_dir / LOG_NAME, metadata, order.plan.log.images)


def _counting(observer: Observer, facts: FlightFacts) -> Observer:
    def count(step: Step, pipeline: Pipeline) -> None:
        facts.frames += 1
        observer(step, pipeline)

    return count


def _reserve_summary(order: FlightOrder, pipeline: Pipeline) -> None:
    killed = FlightFacts(reason="the companion was killed in flight")
    summary = summarise(order.plan, order.plan_path.stem, pipeline, killed)
    text = _json(summary).ljust(SUMMARY_BYTES)
    path = order.log_dir / SUMMARY_NAME
    try:
        path.write_bytes(text)
    except OSError as error:
        raise CompanionError(f"{path}: cannot be written: {error.strerror}") from error


def _leave(order: FlightOrder, pipeline: Pipeline, facts: FlightFacts) -> Summary:
    """The learned model and the summary, beside the log."""
    try:
        save_model(
            order.log_dir / MODEL_NAME, pipeline.learner.state(), pipeline.matcher.calibration
        )
    except CompanionError as error:
        if facts.outcome == "flown":
            facts.outcome, facts.reason = "failed", str(error)
        else:
            logger.error("%s", error)  # the flight's own error says more
    summary = summarise(order.plan, order.plan_path.stem, pipeline, facts)
    path = order.log_dir / SUMMARY_NAME
    try:
        with path.open("r+b") as file:
            file.write(_json(summary))
            file.truncate()
    except OSError as error:
        raise CompanionError(f"{path}: cannot be written: {error.strerror}") from error
    return summary


def _json(summary: Summary) -> bytes:
    return msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n"
