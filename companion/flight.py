"""A flight as a user asks for it: plan in, log folder with summary out."""

import asyncio
import logging
import signal
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

LOG_NAME = "flight.mcap"
MODEL_NAME = "model.npz"
SUMMARY_NAME = "summary.json"

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


async def fly_plan(order: FlightOrder, observer: Observer) -> Summary:
    """Flies; always leaves the log, the model and summary.json, also when the flight fails.

    Raises CompanionError when nothing could fly; a failed or aborted flight is in the summary.
    """
    record = _Record()
    try:
        async with (
            open_rig(order.vehicle, order.camera, _request(order)) as rig,
            rig.camera,
            rig.vehicle,
        ):
            await _fly_with(rig, order, observer, record)
    except CompanionError as error:
        if record.pipeline is None:
            raise
        record.facts.outcome, record.facts.reason = "failed", str(error)
    assert record.pipeline is not None
    summary = summarise(order.plan, order.plan_path.stem, record.pipeline, record.facts)
    _leave(order.log_dir, summary, record.pipeline)
    return summary


async def _fly_with(rig: Rig, order: FlightOrder, observer: Observer, record: _Record) -> None:
    facts = record.facts
    pipeline = record.pipeline = _pipeline(order, rig)
    began_wall_s = wall_s()
    with _open_log(order, rig) as log:
        flight = Flight(rig, pipeline, log, _counting(observer, facts))
        try:
            await _run(flight, facts)
        finally:
            facts.wall_s = wall_s() - began_wall_s
            facts.sim_s = flight.flown_s
            facts.frames_dropped = rig.camera.frames_dropped
            facts.collisions = flight.truth.collisions
            facts.minimum_clearance_m = flight.truth.minimum_clearance_m


async def _run(flight: Flight, facts: FlightFacts) -> None:
    """Runs the flight so that SIGINT and SIGTERM cancel it; fills in how it ended."""
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(flight.run())
    received: list[signal.Signals] = []

    def stop(number: signal.Signals) -> None:
        logger.warning("%s: %s", number.name, "landing" if not received else "already landing")
        if not received:
            task.cancel()
        received.append(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop, number)
    try:
        await task
        facts.outcome = "flown"
    except asyncio.CancelledError:
        if not received:
            raise
        facts.outcome, facts.reason = "aborted", f"stopped by {received[0].name}"
    except CompanionError as error:
        facts.reason = str(error)
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)


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


def _leave(log_dir: Path, summary: Summary, pipeline: Pipeline) -> None:
    """The summary and the learned model, beside the log."""
    try:
        text = msgspec.json.format(msgspec.json.encode(summary), indent=2)
        (log_dir / SUMMARY_NAME).write_bytes(text + b"\n")
    except OSError as error:
        raise CompanionError(f"{log_dir}: cannot be written: {error.strerror}") from error
    save_model(log_dir / MODEL_NAME, pipeline.learner.state(), pipeline.matcher.calibration)
