"""One flight of the matrix in lockstep: the fault comes by the plan's events, the world tells."""

import asyncio
import logging
import math
import resource
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec

from companion.flight import FlightOrder, fly_rig
from companion.flightlog import FlightLog, Topic
from companion.kernel.errors import CompanionError, RecordingError
from companion.logfolder import LOG_NAME
from companion.memory import MODEL_NAME, previous_of
from companion.pipeline import Pipeline, Step
from companion.plan import Plan, load_plan, room_path
from companion.summary import Summary
from sitl.build import Simulation, build
from sitl.lockstep import rig_of
from sitl.simulator import World
from tools.faults.cases import PLAN_WORDS, Case, Outcome, events_of
from tools.faults.results import Flown

PLANS = Path(__file__).parents[2] / "flightplans"
ALONE_S = 60.0
"""How long the vehicle is watched when its companion has given up."""
STILL_M_S = 0.3
DISK_BYTES = 150_000
LESSON = ("experiment.initial_s=6", "experiment.learning_s=0", "experiment.test_s=0")


class Task(NamedTuple):
    """One flight to fly."""

    case: Case
    moment: str
    room: str
    seed: int


def be_quiet() -> None:
    """For a process of its own: faults are what is wanted, and the table tells of them."""
    logging.disable(logging.CRITICAL)


def fly(task: Task) -> Flown:
    """Flies it in this process."""
    cv2.setNumThreads(1)  # as the app does
    plan, plan_path = plan_of(task)
    with tempfile.TemporaryDirectory() as folder:
        model = model_for(task, Path(folder))
        log_dir = Path(folder) / "flight"
        log_dir.mkdir()
        order = FlightOrder(
            plan=plan, plan_path=plan_path, vehicle="lockstep", log_dir=log_dir, model=model
        )
        return _fly(task, order).without_folder(folder)


def plan_of(task: Task) -> tuple[Plan, Path]:
    """The room's own plan, shortened, with the fault at its time."""
    path = PLANS / f"{task.room}.toml"
    plan = load_plan(path, (*PLAN_WORDS, *task.case.words), task.seed)
    events = events_of(task.case, task.moment)
    return msgspec.structs.replace(plan, sitl=plan.sitl | {"events": events}), path


def model_for(task: Task, folder: Path) -> Path | None:
    """A spoilt model to begin with, where the case wants one."""
    if task.case.deed not in ("spoilt model", "spoilt newest model"):
        return None
    path = PLANS / f"{task.room}.toml"
    lesson = folder / "lesson"
    lesson.mkdir()
    plan = load_plan(path, (*PLAN_WORDS, *LESSON), task.seed)
    order = FlightOrder(plan=plan, plan_path=path, vehicle="lockstep", log_dir=lesson)
    simulation = _simulation(plan, path)
    asyncio.run(fly_rig(order, rig_of(simulation), lambda step, pipeline: None))
    newest = lesson / MODEL_NAME
    newest.write_bytes(newest.read_bytes()[:-100])
    if task.case.deed == "spoilt model":
        previous_of(newest).unlink()
    return lesson


def _fly(task: Task, order: FlightOrder) -> Flown:
    simulation = _simulation(order.plan, order.plan_path)
    newest_ns = 0

    def note(step: Step, pipeline: Pipeline) -> None:
        nonlocal newest_ns
        newest_ns = step.percept.stamp_ns

    with _disk_of(DISK_BYTES if task.case.deed == "full disk" else None):
        try:
            summary = asyncio.run(fly_rig(order, rig_of(simulation), note))
        except CompanionError as error:
            return _flown(task, Outcome.REFUSES, str(error))
    return _flown(
        task,
        _outcome(simulation, summary),
        summary.reason,
        simulation.world,
        (newest_ns - _logged_ns(order.log_dir / LOG_NAME)) * 1e-9,
    )


def _simulation(plan: Plan, plan_path: Path) -> Simulation:
    return build(room_path(plan, plan_path), plan.sitl, plan.seed, plan.camera.rate_hz)


def _outcome(simulation: Simulation, summary: Summary) -> Outcome:
    """After the vehicle was left alone for a minute."""
    world = simulation.world
    world.advance_to(world.time_s + ALONE_S)
    if world.crashed is not None and not world.fell:
        return Outcome.CRASHES
    if world.autopilot.status.armed:
        still = math.hypot(*world.truth.velocity_ned_m_s) < STILL_M_S
        return Outcome.HOLDS if still else Outcome.FLIES_AWAY
    return Outcome.FLIES if summary.outcome == "flown" else Outcome.LANDS


def _logged_ns(path: Path) -> int:
    """The newest frame in the log; 0 for none."""
    try:
        return int(FlightLog(path).columns(Topic.PERCEPT)["stamp_ns"][-1])
    except RecordingError:
        return 0


def _flown(
    task: Task, observed: Outcome, reason: str, world: World | None = None, lost_s: float = 0.0
) -> Flown:
    landing_contacts = world.landing_contacts if world else 0
    return Flown(
        way="lockstep",
        case=task.case.name,
        moment=task.moment,
        room=task.room,
        seed=task.seed,
        expected=task.case.expected,
        observed=observed,
        collisions=world.collisions - landing_contacts if world else 0,
        lost_s=max(0.0, lost_s),
        reason=reason,
        landing_contacts=landing_contacts,
        fell=world.fell if world else False,
    )


@contextmanager
def _disk_of(size_bytes: int | None) -> Iterator[None]:
    """No file of this process may grow beyond it, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    if size_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
