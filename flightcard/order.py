"""What a test asks for: the keywords of its ``flight`` markers, checked."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from msgspec import Meta, field

from companion.kernel.errors import PlanError
from companion.kernel.messages import SimulationRequest
from companion.kernel.settings import Settings, convert_settings
from companion.plan import Plan, load_plan, room_path
from sitl.faults import Faults

HALL = Path(__file__).with_name("hall.toml")


class Wishes(Settings, frozen=True):
    """The keywords of the marker and of the ``make_...`` fixtures."""

    room: str | None = None
    """Bare name among the flight plans' rooms, or a path; without one the plan's, else a hall."""
    plan: str | None = None
    """Bare name among the flight plans, or a path: also what ``fly_plan`` flies."""
    overrides: list[str] = field(default_factory=list)
    """``KEY=VALUE`` for the plan."""
    seed: Annotated[int, Meta(ge=0)] | None = None
    speed: Annotated[float, Meta(ge=0.1, le=100)] = 5.0
    """Times real time, where the vehicle is a process; lockstep is as fast as it can."""
    camera_rate_hz: Annotated[float, Meta(ge=1, le=120)] | None = None
    sitl: dict[str, Any] = field(default_factory=dict)
    """The plan's ``[sitl]`` table: these keys replace the plan's."""
    faults: Faults = Faults()
    """Present from the start."""


class Folders(NamedTuple):
    """Where names are looked up, in this order: beside the test, then in the project."""

    test: Path
    project: Path
    plans: Path


class Order(NamedTuple):
    """One vehicle, as it will be made."""

    plan: Plan
    plan_path: Path | None
    """None flies by verbs only."""
    request: SimulationRequest
    faults: Faults


def order_from(wishes: Mapping[str, Any], folders: Folders, log_dir: Path) -> Order:
    """Raises PlanError: which keyword, and what is allowed."""
    wanted = convert_settings(dict(wishes), Wishes, "flight")
    path = find(wanted.plan, folders, folders.plans) if wanted.plan else None
    plan = load_plan(path, wanted.overrides, wanted.seed)
    request = SimulationRequest(
        room=str(_room(wanted, plan, path, folders)),
        seed=plan.seed,
        speed=wanted.speed,
        camera_rate_hz=wanted.camera_rate_hz or plan.camera.rate_hz,
        log_dir=str(log_dir),
        settings={**plan.sitl, **wanted.sitl},
    )
    return Order(plan, path, request, wanted.faults)


def _room(wanted: Wishes, plan: Plan, plan_path: Path | None, folders: Folders) -> Path:
    if wanted.room:
        return find(wanted.room, folders, folders.plans / "rooms")
    return room_path(plan, plan_path) if plan_path and plan.room else HALL


def find(name: str, folders: Folders, shelf: Path) -> Path:
    """``shelf/NAME.toml`` for a bare name; other names beside the test or in the project."""
    bare = "/" not in name and not name.endswith(".toml")
    tried: Sequence[Path] = (
        [shelf / f"{name}.toml"] if bare else [folders.test / name, folders.project / name]
    )
    for path in tried:
        if path.is_file():
            return path
    raise PlanError(f"flight: {name}: no such file; looked for {' and '.join(map(str, tried))}")
