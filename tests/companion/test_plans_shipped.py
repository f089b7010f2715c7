"""The plans that ship, and the page that documents their keys."""

from pathlib import Path

import msgspec
import pytest

from companion.plan import Plan, load_plan, room_path
from sitl.arena.room import RoomSettings, load_room
from sitl.settings import SitlSettings

FOLDER = Path(__file__).parents[2] / "flightplans"
PLANS = sorted(FOLDER.glob("*.toml"))


@pytest.mark.parametrize("path", PLANS, ids=lambda path: path.stem)
def test_every_shipped_plan_loads_with_its_room(path):
    plan = load_plan(path)
    assert load_room(room_path(plan, path)).bounds_ned_m.shape == (2, 3)


@pytest.mark.parametrize("name", ["room1", "room2", "office"])
def test_the_papers_plans_keep_the_papers_schedule_and_table(name):
    plan = load_plan(FOLDER / f"{name}.toml")
    experiment = plan.experiment
    assert (experiment.initial_s, experiment.learning_s, experiment.test_s) == (60, 240, 300)
    assert plan.learner.preset == "paper"
    assert plan.behaviour.forward_speed_m_s == 0.5


def keys(kind, prefix=""):
    for field in msgspec.structs.fields(kind):
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct):
            yield from keys(field.type, f"{prefix}{field.name}.")
        else:
            yield f"{prefix}{field.name}"


@pytest.mark.parametrize(
    ("kind", "prefix"), [(Plan, ""), (SitlSettings, "sitl."), (RoomSettings, "")]
)
def test_every_key_is_documented(kind, prefix):
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    missing = [
        key
        for key in keys(kind, prefix)
        if f"`{key}`" not in page
        and f"`.{key.rpartition('.')[2]}`" not in page
        # Keys of a room's six surfaces are documented once.
        and f"surface.NAME.{key.rpartition('.')[2]}" not in page
        and key not in ("sitl", "poster", "box", "cylinder")
    ]
    assert missing == []
