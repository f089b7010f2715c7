"""A campaign file and the flights that it asks for, each with an id that is always the same."""

import hashlib
import itertools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta, field

from companion.kernel.errors import PlanError
from companion.kernel.settings import Settings, convert_settings, read_toml
from companion.plan import Plan, load_plan, room_path
from sitl.arena.room import Room, load_room, picture_names
from sitl.settings import SitlSettings
from tools.campaign.coverage import free_cells
from tools.overrides import as_word, label_of, leaves

DICTIONARY = "dictionary.npz"


class FlightSettings(Settings, frozen=True):
    """``[[flight]]``: flights that differ from the others by more than one key."""

    name: str
    set: dict[str, Any] = field(default_factory=dict)
    """Keys of the plan and their values."""


class CampaignSettings(Settings, frozen=True):
    """A campaign file: every ``[[flight]]`` with every combination of ``[matrix]``."""

    plan: str
    """Flight plan that all flights start from, relative to the campaign file."""
    runs: Annotated[int, Meta(ge=1, le=10_000)] = 30
    """Flights of each kind; their seeds count up from ``first_seed``."""
    first_seed: Annotated[int, Meta(ge=0)] = 1
    set: dict[str, Any] = field(default_factory=dict)
    """Keys of the plan and their values, for all flights."""
    matrix: dict[str, Any] = field(default_factory=dict)
    """Keys of the plan, each with a list of values."""
    flight: tuple[FlightSettings, ...] = ()


class PlannedFlight(msgspec.Struct, frozen=True, kw_only=True):
    """One flight with all that flying it needs, so that any machine can."""

    id: str
    """Group, seed and a digest of everything else: other settings make another id."""
    group: str
    plan: Plan
    plan_name: str
    files: dict[str, bytes]
    """Room, its pictures and the dictionary, by path relative to the plan."""
    free_cells: int
    """Of the room, that the vehicle could visit."""

    @property
    def seed(self) -> int:
        return self.plan.seed


class Campaign(NamedTuple):
    groups: tuple[str, ...]
    """What is compared, in the order of the file."""
    flights: tuple[PlannedFlight, ...]


def load_campaign(path: Path, runs: int | None = None) -> Campaign:
    """The campaign in ``path``. Raises PlanError: file, key and what is allowed."""
    settings = convert_settings(read_toml(path), CampaignSettings, str(path))
    plan_path = path.parent / settings.plan
    kinds: dict[str, list[PlannedFlight]] = {}
    for name, overrides in _groups(settings, path):
        if name in kinds:
            raise PlanError(
                f"{path}: two kinds of flight are called {name!r}; name each [[flight]]"
            )
        try:
            plan = load_plan(plan_path, overrides)
            kinds[name] = _flights(name, plan, plan_path, settings, runs or settings.runs)
        except PlanError as error:
            raise PlanError(f"{path}: {name}: {error}") from error
    flights = tuple(itertools.chain.from_iterable(kinds.values()))
    return Campaign(tuple(kinds), flights)


def _groups(settings: CampaignSettings, path: Path) -> Iterator[tuple[str, list[str]]]:
    """Name and ``KEY=VALUE`` words of each kind of flight."""
    common = _words(settings.set, f"{path}: set")
    axes = [
        [(label_of(key, value), _word(key, value, f"{path}: matrix")) for value in values]
        for key, values in _axes(settings.matrix, f"{path}: matrix")
    ]
    for flight in settings.flight or (FlightSettings(name=""),):
        own = _words(flight.set, f"{path}: flight {flight.name}: set")
        for chosen in itertools.product(*axes):
            labels = [label for label, _ in chosen]
            name = " ".join(filter(None, (flight.name, *labels)))
            yield name or path.stem, [*common, *own, *(word for _, word in chosen)]


def _axes(table: dict[str, Any], where: str) -> Iterator[tuple[str, list[Any]]]:
    for key, values in leaves(table):
        if not isinstance(values, list) or not values:
            raise PlanError(f"{where}: {key}: must be a list of values, e.g. [1, 2]")
        yield key, values


def _words(table: dict[str, Any], where: str) -> list[str]:
    return [_word(key, value, where) for key, value in leaves(table)]


def _word(key: str, value: object, where: str) -> str:
    if key == "seed":
        raise PlanError(f"{where}: seed: not here; first_seed and runs say which seeds are flown")
    return as_word(key, value)


def _flights(
    group: str, plan: Plan, plan_path: Path, settings: CampaignSettings, runs: int
) -> list[PlannedFlight]:
    convert_settings(dict(plan.sitl), SitlSettings, "sitl")
    room = load_room(room_path(plan, plan_path))
    plan, files = _self_contained(plan, plan_path, room)
    digest = _digest(plan, files)
    cells = free_cells(room, plan.behaviour.height_m)
    slug = re.sub(r"[^A-Za-z0-9_.]+", "-", group).strip("-")
    seeds = range(settings.first_seed, settings.first_seed + runs)
    return [
        PlannedFlight(
            id=f"{slug}-{seed:04d}-{digest}",
            group=group,
            plan=msgspec.structs.replace(plan, seed=seed),
            plan_name=plan_path.stem,
            files=files,
            free_cells=cells,
        )
        for seed in seeds
    ]


def _self_contained(plan: Plan, plan_path: Path, room: Room) -> tuple[Plan, dict[str, bytes]]:
    """The plan with images off and files under names of its own, and those files."""
    name = room.source.stem
    files = {f"rooms/{name}.toml": room.source.read_bytes()}
    for picture in picture_names(room.settings):
        if Path(picture).is_absolute() or ".." in Path(picture).parts:
            raise PlanError(f"{room.source}: {picture}: must lie below the room's folder")
        files[f"rooms/{picture}"] = (room.source.parent / picture).read_bytes()
    learner = plan.learner
    if learner.dictionary:
        path = plan_path.parent / learner.dictionary
        if not path.is_file():
            raise PlanError(f"learner.dictionary: {path}: no such file")
        files[DICTIONARY] = path.read_bytes()
        learner = msgspec.structs.replace(learner, dictionary=DICTIONARY)
    log = msgspec.structs.replace(plan.log, images="off")
    return msgspec.structs.replace(plan, room=name, learner=learner, log=log), files


def _digest(plan: Plan, files: Mapping[str, bytes]) -> str:
    settings = msgspec.structs.replace(plan, seed=0)
    digest = hashlib.blake2s(msgspec.json.encode(settings, order="deterministic"), digest_size=4)
    digest.update(file_digest(files).encode())
    return digest.hexdigest()


def file_digest(files: Mapping[str, bytes]) -> str:
    """A short name for these files: the same for the same bytes."""
    digest = hashlib.blake2s(digest_size=8)
    for name, content in sorted(files.items()):
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()
