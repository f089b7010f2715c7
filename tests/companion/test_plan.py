"""Plans: defaults, overrides, and what no single key can show."""

import pytest

from companion.kernel.errors import PlanError
from companion.plan import Plan, load_plan, room_path


@pytest.fixture
def plan_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('room = "hall"\nseed = 3\n[experiment]\nscheme = "dagger"\ntest_s = 20.0\n')
    return path


def test_no_file_means_all_defaults():
    assert load_plan(None) == Plan()


def test_a_file_changes_only_what_it_says(plan_file):
    plan = load_plan(plan_file)
    assert (plan.room, plan.seed, plan.experiment.scheme) == ("hall", 3, "dagger")
    assert plan.experiment.initial_s == Plan().experiment.initial_s
    assert plan.behaviour == Plan().behaviour


@pytest.mark.parametrize(
    ("override", "read"),
    [
        ("experiment.test_s=7", lambda plan: plan.experiment.test_s == 7.0),
        ("experiment.scheme=cold_turkey", lambda plan: plan.experiment.scheme == "cold_turkey"),
        ('experiment.scheme="pure_stereo"', lambda plan: plan.experiment.scheme == "pure_stereo"),
        (" seed = 9 ", lambda plan: plan.seed == 9),
        ("sitl.wind_ned_m_s=[1, 0, 0]", lambda plan: plan.sitl == {"wind_ned_m_s": [1, 0, 0]}),
        ("sitl.battery.capacity_mah=9", lambda plan: plan.sitl == {"battery": {"capacity_mah": 9}}),
    ],
)
def test_overrides_are_toml_values_and_bare_words(plan_file, override, read):
    assert read(load_plan(plan_file, [override]))


def test_the_last_override_wins_and_the_seed_comes_after_all(plan_file):
    plan = load_plan(plan_file, ["seed=5", "experiment.test_s=1", "experiment.test_s=2"], seed=6)
    assert (plan.seed, plan.experiment.test_s) == (6, 2.0)


@pytest.mark.parametrize("override", ["seed", "", "=", "=3", ".=3", "a.=3", ".a=3", "a..b=3"])
def test_an_override_must_be_key_and_value(override):
    with pytest.raises(PlanError, match="must be KEY=VALUE"):
        load_plan(None, [override])


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["behaviour.override_threshold_px=1"], "override_threshold_px: 1.0 is below turn_"),
        (["behaviour.forward_speed_m_s=2"], "forward_speed_m_s: 2.0 exceeds safety.max_speed_m_s"),
        (["behaviour.height_m=5"], "height_m: 5.0 exceeds safety.geofence_height_m"),
        (["safety.hold_after_s=9"], "safety: needs stop_after_s < hold_after_s < land_after_s"),
    ],
)
def test_values_must_fit_together(overrides, said):
    with pytest.raises(PlanError, match=f"^plan: .*{said}"):
        load_plan(None, overrides)


def test_a_room_is_a_name_or_a_path_beside_the_plan(plan_file):
    room = plan_file.parent / "rooms" / "hall.toml"
    plan = load_plan(plan_file)
    with pytest.raises(PlanError, match=r"hall\.toml does not exist; rooms here: none"):
        room_path(plan, plan_file)
    room.parent.mkdir()
    room.touch()
    assert room_path(plan, plan_file) == room
    assert room_path(load_plan(plan_file, ["room=rooms/hall.toml"]), plan_file) == room
    with pytest.raises(PlanError, match=r"rooms here: hall$"):
        room_path(load_plan(plan_file, ["room=cellar"]), plan_file)
