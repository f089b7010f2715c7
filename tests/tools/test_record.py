"""A recording survives being recorded again: same pairs, same geometry."""

from pathlib import Path

import numpy as np
import pytest

from companion.camera.recording import open_recording
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.frames import matrix_from_euler
from tools import record

SAMPLE = Path(__file__).parents[1] / "data" / "room1"


def test_the_shipped_sample_copies_pixel_by_pixel(tmp_path):
    assert record.main([str(SAMPLE), "--out", str(tmp_path / "copy")]) == 0
    original, copy = open_recording(SAMPLE), open_recording(tmp_path / "copy")
    assert copy.calibration == original.calibration
    assert len(copy) == len(original) == 12
    for before, after in zip(original, copy, strict=True):
        assert before.stamp_ns == after.stamp_ns
        np.testing.assert_array_equal(before.left, after.left)
        np.testing.assert_array_equal(before.right, after.right)


def test_every_and_pairs_thin_the_recording(tmp_path):
    words = [str(SAMPLE), "--out", str(tmp_path / "thin"), "--every", "3", "--pairs", "2"]
    assert record.main(words) == 0
    kept = [frame.stamp_ns for frame in open_recording(tmp_path / "thin")]
    assert kept == [frame.stamp_ns for frame in open_recording(SAMPLE)][:6:3]


def test_a_turned_right_eye_survives_the_file(tmp_path):
    eye = Intrinsics(120.0, 121.0, 64.0, 48.5, (0.1, -0.2, 0.001, 0.002))
    turned = tuple(matrix_from_euler(0.01, -0.02, 0.03).ravel().tolist())
    calibration = StereoCalibration(128, 96, eye, eye, 0.06, turned)
    record.AslWriter(tmp_path / "turned", calibration).write(next(iter(open_recording(SAMPLE))))
    found = open_recording(tmp_path / "turned").calibration
    assert found.left == found.right == eye
    assert found.baseline_m == pytest.approx(0.06)
    np.testing.assert_allclose(found.right_from_left, turned, atol=1e-9)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["/nowhere/at/all", "--out", "{new}"], 2, "no such file"),
        ([str(SAMPLE), "--out", str(SAMPLE)], 2, "not empty"),
    ],
)
def test_mistakes_are_one_line(tmp_path, capsys, words, code, said):
    assert record.main([word.format(new=tmp_path / "new") for word in words]) == code
    text = capsys.readouterr().err
    assert said in text
    assert text.count("\n") == 1


def test_simulated_recordings_are_flown_where_they_are_missing(tmp_path, capsys):
    for name in ("room2", "office", "corridor"):
        (tmp_path / name).mkdir()
    phases = [f"experiment.{phase}_s=2" for phase in ("initial", "learning", "test")]
    assert record.main(["--all", str(tmp_path), "--every", "5", "--set", *phases]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'room1'}: 12 pairs\n"
    recording = open_recording(tmp_path / "room1")
    assert len(recording) == 12
    assert recording.calibration.baseline_m == 0.06
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "corridor", "office", "room1", "room2"
    ]  # fmt: skip


def test_a_flight_that_cannot_be_made_leaves_nothing(tmp_path, capsys):
    assert record.main(["--all", str(tmp_path), "--set", "learner.k=0"]) == 2
    assert "learner.k" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
