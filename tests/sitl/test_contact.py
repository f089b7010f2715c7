"""Distances to surfaces: the walls, boxes and pillars of a room."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.arena.contact import RoomContact
from sitl.arena.room import BoxSettings, CylinderSettings, RoomSettings, build_room

ROOM = build_room(
    RoomSettings(
        size_m=(6.0, 4.0, 3.0),
        box=(
            BoxSettings(centre_m=(1.5, 0.5, 0.5), size_m=(1.0, 0.6, 1.0)),
            BoxSettings(centre_m=(-1.5, -1.0, 2.0), size_m=(0.4, 0.8, 0.6)),
        ),
        cylinder=(CylinderSettings(centre_m=(0.0, 1.0), radius_m=0.3, height_m=1.2, bottom_m=0.4),),
    ),
    Path("room.toml"),
)
CONTACT = RoomContact(ROOM)

anywhere = st.tuples(st.floats(-2.9, 2.9), st.floats(-1.9, 1.9), st.floats(-2.9, -0.1))


@pytest.mark.parametrize(
    ("point", "distance_m", "normal"),
    [
        ((2.8, -1.0, -1.5), 0.2, (-1, 0, 0)),
        ((-2.8, 1.0, -1.5), 0.2, (1, 0, 0)),
        ((0.0, 1.9, -2.5), 0.1, (0, -1, 0)),
        ((0.0, -1.9, -1.5), 0.1, (0, 1, 0)),
        ((0.0, -0.5, -2.9), 0.1, (0, 0, 1)),
        ((1.5, 0.5, -1.1), 0.1, (0, 0, -1)),
        ((0.9, 0.5, -0.5), 0.1, (-1, 0, 0)),
        ((1.5, 0.5, -0.9), -0.1, (0, 0, -1)),
        ((0.4, 1.0, -1.0), 0.1, (1, 0, 0)),
        ((0.0, 1.0, -1.7), 0.1, (0, 0, -1)),
        ((0.0, 1.0, -0.3), 0.1, (0, 0, 1)),
        ((0.0, 0.75, -1.0), -0.05, (0, -1, 0)),
        ((3.1, 0.0, -1.5), -0.1, (-1, 0, 0)),
    ],
)
def test_nearest_surface_of_known_places(point, distance_m, normal):
    found_m, found_normal = CONTACT.nearest(point)

    assert found_m == pytest.approx(distance_m, abs=1e-9)
    np.testing.assert_allclose(found_normal, normal, atol=1e-9)


def test_floor_is_not_an_obstacle():
    distance_m, _ = CONTACT.nearest((0.0, -0.5, -0.01))
    assert distance_m > 0.5


def test_corner_of_a_box_pushes_along_the_diagonal():
    distance_m, normal = CONTACT.nearest((0.9, 0.1, -1.1))

    assert distance_m == pytest.approx(0.1 * math.sqrt(3.0))
    np.testing.assert_allclose(normal, np.full(3, -1.0) / math.sqrt(3.0))


@settings(max_examples=300)
@given(anywhere)
def test_following_the_normal_back_ends_on_the_surface(point):
    distance_m, normal = CONTACT.nearest(point)

    assert math.hypot(*normal) == pytest.approx(1.0)
    at_surface = tuple(p - distance_m * n for p, n in zip(point, normal, strict=True))
    assert CONTACT.nearest(at_surface)[0] == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=300)
@given(anywhere, anywhere)
def test_distance_changes_no_faster_than_the_point_moves(one, other):
    difference_m = CONTACT.nearest(one)[0] - CONTACT.nearest(other)[0]
    assert abs(difference_m) <= math.dist(one, other) + 1e-9
