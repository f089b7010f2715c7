"""What a campaign file asks for, and the mistakes that can be made in one."""

from pathlib import Path

import msgspec
import pytest

from companion.kernel.errors import PlanError
from companion.plan import load_plan
from tools.campaign.__main__ import main
from tools.campaign.plan import load_campaign

FOLDER = Path(__file__).parents[3] / "flightplans" / "campaigns"
SCHEMES = ("pure_stereo", "cold_turkey", "dagger", "training_wheels")


@pytest.mark.parametrize(
    ("name", "groups", "count"),
    [
        ("schemes", SCHEMES, 120),
        ("persistence", SCHEMES[1:], 90),
        ("rooms", ("room1", "room2"), 10),
    ],
)
def test_the_shipped_campaigns_are_the_papers(name, groups, count):
    campaign = load_campaign(FOLDER / f"{name}.toml")
    assert campaign.groups == groups
    assert len({flight.id for flight in campaign.flights}) == count
    for flight in campaign.flights:
        experiment = flight.plan.experiment
        assert (experiment.initial_s, experiment.learning_s, experiment.test_s) == (60, 240, 300)
        assert experiment.test_override == (name != "persistence")
        assert (flight.plan.learner.preset, flight.plan.log.images) == ("paper", "off")
    for group in groups:
        seeds = [flight.seed for flight in campaign.flights if flight.group == group]
        assert seeds == list(range(1, count // len(groups) + 1))


def test_one_eye_compares_the_papers_design_with_one_that_minds_its_doubts():
    campaign = load_campaign(FOLDER / "one_eye.toml", runs=1)
    plans = dict(zip(campaign.groups, (flight.plan for flight in campaign.flights), strict=True))
    for room in ("office", "room1", "room2"):
        own, paper = plans[room], plans[f"{room}, paper"]
        learner = msgspec.structs.replace(own.learner, preset="paper", caution_std=0.0)
        learner = msgspec.structs.replace(learner, novelty_limit=1000.0)
        assert msgspec.structs.replace(own, learner=learner) == paper
        assert (own.room, own.learner.preset, own.learner.caution_std) == (room, "best", 1.0)
        assert not own.experiment.test_override
        assert own.sitl["events"] == [{"at_s": 310.0, "right_eye": "no_frames"}]
        shipped = load_plan(FOLDER.parent / f"{room}.toml")
        for key in ("turn_threshold_px", "override_threshold_px"):
            assert getattr(own.behaviour, key) == getattr(shipped.behaviour, key)
        assert own.safety == shipped.safety


def test_room1_and_room2_differ_in_nothing_but_the_room():
    campaign = load_campaign(FOLDER / "rooms.toml", runs=1)
    own = load_campaign(FOLDER / "rooms.toml", runs=1).flights[1].plan
    assert msgspec.structs.replace(own, room="room1") == campaign.flights[0].plan
    one, other = (FOLDER.parent / f"{name}.toml" for name in campaign.groups)
    lines = [path.read_text().splitlines()[1:] for path in (one, other)]
    assert [line.replace("room1", "room2") for line in lines[0]] == lines[1]


def test_flights_and_matrix_multiply(campaign_file):
    campaign = load_campaign(
        campaign_file(
            """
runs = 2
first_seed = 7
[matrix]
experiment.scheme = ["dagger", "cold_turkey"]
learner.threshold_ratio = [0.87, 1.0]
[[flight]]
name = "slow"
set.behaviour.forward_speed_m_s = 0.3
[[flight]]
name = "fast"
set."behaviour.forward_speed_m_s" = 0.7
"""
        )
    )
    assert len(campaign.groups) == 8
    assert campaign.groups[0] == "slow dagger threshold_ratio=0.87"
    last = campaign.flights[-1]
    assert (last.group, last.seed) == ("fast cold_turkey threshold_ratio=1.0", 8)
    assert last.plan.behaviour.forward_speed_m_s == 0.7
    assert last.plan.learner.threshold_ratio == 1.0


def test_ids_depend_on_settings_and_files_alone(campaign_file):
    ids = [flight.id for flight in load_campaign(campaign_file()).flights]
    assert [flight.id for flight in load_campaign(campaign_file(name="b.toml")).flights] == ids
    more = load_campaign(campaign_file(), runs=5).flights
    assert set(ids) < {flight.id for flight in more}
    other = campaign_file("runs = 3\n[matrix]\nexperiment.scheme = ['pure_stereo']\n")
    assert not set(ids) & {flight.id for flight in load_campaign(other).flights}


def test_a_flight_brings_its_room_with_pictures(tmp_path, campaign_file):
    (tmp_path / "rooms" / "art").mkdir(parents=True)
    (tmp_path / "rooms" / "art" / "cat.png").write_bytes(b"a picture")
    room = 'size_m = [4, 4, 3]\n[surface]\nnorth = { texture = "art/cat.png" }\n'
    (tmp_path / "rooms" / "mine.toml").write_text(room)
    (tmp_path / "mine.toml").write_text('room = "mine"\n')
    path = tmp_path / "campaign.toml"
    path.write_text('plan = "mine.toml"\nruns = 1\n')
    (flight,) = load_campaign(path).flights
    assert flight.files == {"rooms/mine.toml": room.encode(), "rooms/art/cat.png": b"a picture"}
    assert flight.group == "campaign"
    assert flight.free_cells == 64  # the hull fits into a part of each of the 8 x 8


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("run = 3", "run: unknown key; did you mean 'runs'? allowed here: first_seed, flight"),
        ("runs = 0", "runs: Expected `int` >= 1"),
        ("[[flight]]\nnames = 'x'", "flight[0].names: unknown key; did you mean 'name'?"),
        ("[matrix]\nroom = 'office'", "matrix: room: must be a list of values, e.g. [1, 2]"),
        ("[matrix]\nroom = []", "matrix: room: must be a list of values"),
        ("[matrix]\nroom = ['office', 'office']", "two kinds of flight are called 'office'"),
        ("[matrix]\nexperiment.schemes = ['dagger']", "experiment.schemes: unknown key; did you"),
        ("[matrix]\nexperiment.scheme = ['no']", "no: .*allowed: pure_stereo, cold_turkey"),
        ("[matrix]\nroom = ['cellar']", "cellar.toml does not exist; rooms here: corridor"),
        ("[set]\nseed = 3", "set: seed: not here; first_seed and runs say which seeds are flown"),
        ("[set]\nsitl.wind = 3", "sitl: wind: unknown key"),
        ("[set]\nlearner.dictionary = 'no.npz'", "learner.dictionary: .*no.npz: no such file"),
        ("[set", "not valid TOML"),
    ],
)
def test_a_wrong_campaign_is_refused(campaign_file, capsys, tmp_path, text, said):
    path = campaign_file(text)
    with pytest.raises(PlanError, match=said.replace("[", r"\[").replace("?", r"\?")):
        load_campaign(path)
    assert main([str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"campaign: {path}: ")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_no_campaign_file(capsys, tmp_path):
    assert main([str(tmp_path / "none.toml")]) == 2
    assert capsys.readouterr().err == f"campaign: {tmp_path / 'none.toml'}: no such file\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--runs", "0"], "argument --runs: invalid count value: '0'"),
        (["--workers", "some"], "argument --workers: invalid count value: 'some'"),
        (["--workers", "1", "--scheduler", "tcp://127.0.0.1:1"], "not allowed with"),
    ],
)
def test_wrong_words_are_usage(campaign_file, capsys, words, said):
    with pytest.raises(SystemExit) as end:
        main([str(campaign_file()), *words])
    assert end.value.code == 2
    assert said in capsys.readouterr().err
