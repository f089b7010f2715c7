"""Frames of reference and settings."""

import math
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta

from companion.kernel import frames
from companion.kernel.errors import PlanError
from companion.kernel.settings import Settings, convert_settings, read_toml

angle = st.floats(-3.1, 3.1)
tilt = st.floats(-1.5, 1.5)


class Inner(Settings, frozen=True):
    speed_m_s: Annotated[float, Meta(gt=0)] = 1.0


class Outer(Settings, frozen=True):
    inner: Inner = Inner()
    count: int = 1


@given(st.floats(-1e4, 1e4))
def test_wrapping_keeps_the_direction(angle_rad):
    wrapped = frames.wrap_angle_rad(angle_rad)
    assert -math.pi <= wrapped < math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle_rad), abs_tol=1e-9)


@given(angle, tilt, angle)
def test_euler_angles_survive_the_quaternion(roll, pitch, yaw):
    q = frames.quaternion_from_euler(roll, pitch, yaw)
    assert q[0] >= 0
    assert math.isclose(sum(value**2 for value in q), 1.0)
    assert np.allclose(frames.euler_from_quaternion(q), (roll, pitch, yaw), atol=1e-6)


@given(angle, tilt, angle)
def test_the_matrix_is_a_rotation(roll, pitch, yaw):
    matrix = frames.matrix_from_euler(roll, pitch, yaw)
    assert np.allclose(matrix @ matrix.T, np.eye(3))
    assert math.isclose(np.linalg.det(matrix), 1.0)


def test_axes_point_where_the_names_say():
    east_facing = frames.matrix_from_euler(0, 0, math.pi / 2)
    assert np.allclose(east_facing @ (1, 0, 0), (0, 1, 0))
    nose_up = frames.matrix_from_euler(0, 0.1, 0)
    assert (nose_up @ (1, 0, 0))[2] < 0
    right_wing_down = frames.matrix_from_euler(0.1, 0, 0)
    assert (right_wing_down @ (0, 1, 0))[2] > 0
    assert np.allclose(frames.ned_from_hfrd(1.0, 0.0, math.pi / 2), (0.0, 1.0))


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"inner": {"sped_m_s": 1}}, ["inner.sped_m_s", "unknown key", "speed_m_s"]),
        ({"inner": {"speed_m_s": "1 km/h"}}, ["inner.speed_m_s", "float", "str"]),
        ({"inner": {"speed_m_s": -1.0}}, ["inner.speed_m_s", "> 0"]),
        ({"inner": {"speed_m_s": math.nan}}, ["inner.speed_m_s", "nan", "finite"]),
        ({"inner": 3}, ["inner", "int"]),
        ({"cout": 3}, ["cout", "did you mean 'count'", "count, inner"]),
    ],
)
def test_a_wrong_setting_is_named_with_its_path_and_what_is_allowed(table, words):
    with pytest.raises(PlanError) as caught:
        convert_settings(table, Outer, "plan.toml")
    text = str(caught.value)
    assert text.startswith("plan.toml: ")
    assert "\n" not in text
    assert all(word in text for word in words), text


@pytest.mark.parametrize("content", [b"a = ", b"\xff\xfe", b"[a]\n[a]\n"])
def test_a_file_that_is_no_toml_is_refused_by_name(tmp_path, content):
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(PlanError, match=r"broken\.toml"):
        read_toml(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(PlanError, match=r"nowhere\.toml: no such file"):
        read_toml(tmp_path / "nowhere.toml")
