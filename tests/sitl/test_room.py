"""Room files: what they mean, and what they are told when they are wrong."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.kernel.errors import PlanError
from sitl.arena.room import RoomSettings, build_room, load_room

ROOMS = Path(__file__).parents[2] / "flightplans" / "rooms"
SHIPPED = sorted(path.stem for path in ROOMS.glob("*.toml"))


def load(tmp_path, text):
    path = tmp_path / "room.toml"
    path.write_text("size_m = [6.0, 4.0, 3.0]\n" + text)
    return load_room(path)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_room_loads(name):
    room = load_room(ROOMS / f"{name}.toml")

    north, east, down = room.start_position_ned_m
    assert room.bounds_ned_m[0, 0] < north < room.bounds_ned_m[1, 0]
    assert room.bounds_ned_m[0, 1] < east < room.bounds_ned_m[1, 1]
    assert down == 0.0


def test_sizes_of_the_papers_rooms():
    for name in ("room1", "room2"):
        assert load_room(ROOMS / f"{name}.toml").settings.size_m[:2] == (5.0, 5.0)
    assert load_room(ROOMS / "office.toml").settings.size_m[:2] == (10.0, 10.0)


def test_places_become_ned_with_the_origin_on_the_floor(tmp_path):
    room = load(
        tmp_path,
        """
        [[box]]
        centre_m = [1.0, 0.5, 0.4]
        size_m = [0.2, 0.6, 0.8]
        [[cylinder]]
        centre_m = [-1.0, 1.0]
        radius_m = 0.3
        height_m = 2.0
        bottom_m = 0.5
        """,
    )

    np.testing.assert_allclose(room.bounds_ned_m, [(-3, -2, -3), (3, 2, 0)])
    np.testing.assert_allclose(room.boxes_ned_m, [(0.9, 0.2, -0.8, 1.1, 0.8, 0.0)])
    np.testing.assert_allclose(room.cylinders_ned_m, [(-1.0, 1.0, 0.3, -2.5, -0.5)])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("heigth_m = 3.0", r"heigth_m: unknown key.*allowed here:.*size_m"),
        ("[surface]\nnorth = { colour = 1 }", r"surface\.north\.colour: unknown key"),
        ("[surface]\nnorth = { texture = 'brik' }", r"surface\.north\.texture: no texture 'brik'"),
        ("[surface]\nnorth = { texture = 'brik' }", r"allowed: .*plywood_tape.*photo:NAME"),
        ("[surface]\neast = { texture = 'gone.png' }", r"surface\.east\.texture: no picture"),
        ("[start]\nposition_m = [3.5, 0.0]", r"start\.position_m: .*only from -3 to 3 m"),
        (
            "[[poster]]\nwall='east'\ntexture='poster'\ncentre_m=[2.8, 1.5]\nsize_m=[1.0, 1.0]",
            r"poster\[0\]: reaches from 2\.3 to 3\.3 m",
        ),
        ("[[box]]\ncentre_m=[0, 0, 0.1]\nsize_m=[1, 1, 0.5]", r"box\[0\]: reaches from -0\.15"),
        ("[[box]]\ncentre_m=[0, 0, 1]\nsize_m=[1, 0, 1]", r"box\[0\]\.size_m\[1\]"),
        ("[[cylinder]]\ncentre_m=[0, 1.9]\nradius_m=0.2\nheight_m=1", r"cylinder\[0\]: reaches"),
    ],
)
def test_error_names_file_key_and_what_is_allowed(tmp_path, text, said):
    with pytest.raises(PlanError, match=rf"room\.toml: .*{said}"):
        load(tmp_path, text)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(PlanError, match=r"nowhere\.toml: no such file"):
        load_room(tmp_path / "nowhere.toml")


def test_settings_survive_writing_and_reading():
    settings = load_room(ROOMS / "office.toml").settings

    again = msgspec.convert(msgspec.to_builtins(settings), RoomSettings)

    assert build_room(again, ROOMS / "office.toml").settings == settings
