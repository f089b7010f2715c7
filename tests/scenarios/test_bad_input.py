"""Mistakes of a user: one line that says what and where, exit code 2, and no empty folders."""

from pathlib import Path

import pytest

from companion.cli import main

PLANS = Path(__file__).parents[2] / "flightplans"
ROOM = """
size_m = [5.0, 5.0, 3.0]
seed = 1
[start]
position_m = [0.0, 0.0]
[surface]
north = { texture = "brick" }
east = { texture = "brick" }
south = { texture = "brick" }
west = { texture = "brick" }
floor = { texture = "concrete" }
ceiling = { texture = "paint" }
[[poster]]
wall = "north"
texture = "carpet"
centre_m = [0.0, 1.5]
size_m = [2.0, 1.0]
"""


@pytest.fixture
def fly(tmp_path, capsys):
    """Flies and returns (exit code, the only line on stderr)."""

    def fly(plan, *words, vehicle="lockstep"):
        logs = tmp_path / "logs"
        code = main(["fly", str(plan), "--vehicle", vehicle, "--log-dir", str(logs), *words])
        out, error = capsys.readouterr()
        assert out == ""
        assert error.count("\n") == 1
        assert not logs.exists() or not list(logs.iterdir())
        return code, error

    return fly


@pytest.fixture
def plan_in(tmp_path):
    """Writes a plan and its room."""

    def write(room=ROOM, plan='room = "mine"\n'):
        (tmp_path / "rooms").mkdir()
        (tmp_path / "rooms" / "mine.toml").write_text(room)
        path = tmp_path / "mine.toml"
        path.write_text(plan)
        return path

    return write


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("behaviour.turn_threshold=3", "behaviour.turn_threshold: unknown key; did you mean"),
        ("behavior.height_m=1", "behavior: unknown key; did you mean 'behaviour'?"),
        ("behaviour.height_m=high", "behaviour.height_m: Expected `float`, got `str`"),
        ("experiment.initial_s=-3", "experiment.initial_s: Expected `float` >= 0.0"),
        ("experiment.initial_s=nan", "experiment.initial_s: nan; must be a finite number"),
        ("experiment.scheme=foo", "allowed: pure_stereo, cold_turkey, dagger, training_wheels"),
        ("behaviour.height_m=9", "behaviour.height_m: 9.0 exceeds safety.geofence_height_m"),
        ("camera.rate_hz=7", "camera rate 7 Hz: its period must be a whole number of physics"),
        ("sitl.wind=3", "sitl: wind: unknown key"),
        ("sitl.airframe=zeppelin", "airframe 'zeppelin': no such aircraft; available: ardrone2"),
        ("learner.dictionary=no.npz", "no.npz: no such file"),
        ("room=nowhere", "nowhere.toml does not exist; rooms here: "),
        ('room=""', "room: missing; a simulated flight needs a room file"),
        ("nonsense", "--set nonsense: must be KEY=VALUE"),
        ("=3", "--set =3: must be KEY=VALUE"),
        ("behaviour..height_m=1", "--set behaviour..height_m=1: must be KEY=VALUE"),
        ("seed.x=3", "--set seed.x=3: seed is a value, not a table"),
    ],
)
def test_a_wrong_plan_is_refused(fly, override, said):
    code, line = fly(PLANS / "office.toml", "--set", override)
    assert (code, said in line) == (2, True), line


@pytest.mark.parametrize(
    ("good", "wrong", "said"),
    [
        ("texture = ", "textur = ", "unknown key; did you mean 'texture'?"),
        ('wall = "north"', 'wall = "nort"', "poster[0].wall: Invalid enum value 'nort'; allowed: "),
        ('"brick"', '"brik"', "surface.north.texture: no texture 'brik'; allowed: "),
        ("size_m = [2.0, 1.0]", "size_m = [9.0, 1.0]", "poster[0]"),
        ("size_m = [5.0, 5.0, 3.0]", "", "size_m"),
        ("seed = 1", "seed = ", "not valid TOML"),
    ],
)
def test_a_wrong_room_is_refused(fly, plan_in, good, wrong, said):
    code, line = fly(plan_in(ROOM.replace(good, wrong)))
    assert (code, said in line, "mine.toml" in line) == (2, True, True), line


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b'room = "office\n', "not valid TOML: Illegal character"),
        (b"\xff\xfe", "cannot be read: 'utf-8'"),
        (b"experiment = 3\n", "experiment: Expected `object`, got `int`"),
    ],
)
def test_a_damaged_plan_is_refused(fly, tmp_path, content, said):
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    code, line = fly(path)
    assert (code, f"{path}: {said}" in line) == (2, True), line


def test_no_plan_file(fly, tmp_path):
    assert fly(tmp_path / "none.toml") == (2, f"companion: {tmp_path}/none.toml: no such file\n")


def test_the_simulators_own_process_says_it_once_too(fly):
    code, line = fly(PLANS / "office.toml", "--set", "sitl.wind=3", vehicle="sitl")
    assert (code, line.startswith("companion: sitl: wind: unknown key")) == (2, True), line


@pytest.mark.parametrize(
    ("vehicle", "camera", "said"),
    [
        ("nonsense", "sitl", "--vehicle nonsense: unknown; allowed: lockstep, sitl, a MAVLink URL"),
        ("foo://bar", "tcp://127.0.0.1:1", "--vehicle foo://bar: unknown; allowed: "),
        ("udpin://127.0.0.1:0", "sitl", "--camera sitl: needs a simulator as --vehicle"),
        ("sitl", "none.mp4", "--camera none.mp4: no such file; allowed: "),
        ("lockstep", "tcp://127.0.0.1:1", "lockstep brings its own; allowed: sitl"),
    ],
)
def test_devices_that_do_not_exist_are_refused(fly, vehicle, camera, said):
    code, line = fly(PLANS / "office.toml", "--camera", camera, vehicle=vehicle)
    assert (code, said in line) == (2, True), line


def test_a_log_folder_that_cannot_be_made(capsys, tmp_path):
    (tmp_path / "file").touch()
    words = ["--vehicle", "lockstep", "--log-dir", str(tmp_path / "file")]
    assert main(["fly", str(PLANS / "office.toml"), *words]) == 1
    assert capsys.readouterr().err.endswith("cannot be made: Not a directory\n")


@pytest.fixture
def learn(capsys):
    def learn(*words):
        code = main(["learn", *map(str, words)])
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        return code, error

    return learn


@pytest.fixture
def log_without_images(fly_lockstep):
    words = [f"experiment.{word}" for word in ("initial_s=1", "learning_s=0", "test_s=0")]
    return fly_lockstep(*words).log_dir / "flight.mcap"


def test_a_log_without_images_teaches_nothing(learn, log_without_images):
    code, line = learn(log_without_images)
    assert (code, f"{log_without_images}: logged no images; fly with" in line) == (1, True)


def test_a_stump_of_a_log_is_refused(learn, log_without_images, tmp_path):
    stump = tmp_path / "stump.mcap"
    stump.write_bytes(log_without_images.read_bytes()[:30])
    code, line = learn(stump)
    assert (code, line == f"companion: {stump}: not a flight log (MCAP): cut off\n") == (1, True)


def test_a_recording_needs_its_calibration(learn, tmp_path):
    code, line = learn(tmp_path)
    assert code == 1
    assert "sensor.yaml: missing: a recording needs its calibration" in line
