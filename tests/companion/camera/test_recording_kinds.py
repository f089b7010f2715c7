"""Left/right folders and side-by-side videos come back as they were written, like any recording."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from companion.camera.recording import open_recording
from companion.camera.spec import RecordedSpec, parse_camera
from companion.cli import main
from companion.kernel.errors import PlanError, RecordingError

EYE_TOML = "focal_x_px = 60\nfocal_y_px = 60\ncentre_x_px = 32\ncentre_y_px = 24\n"
CALIBRATION_TOML = (
    f"width_px = 64\nheight_px = 48\nbaseline_m = 0.06\n[left]\n{EYE_TOML}[right]\n{EYE_TOML}"
)
N_PAIRS = 12


@pytest.fixture
def images():
    return np.random.default_rng(1).integers(0, 256, (N_PAIRS, 2, 48, 64)).astype(np.uint8)


@pytest.fixture
def folder(tmp_path, images):
    """Named by frame number; the tenth comes after the ninth."""
    take = tmp_path / "take"
    for eye, name in enumerate(("left", "right")):
        (take / name).mkdir(parents=True)
        for number, pair in enumerate(images):
            cv2.imwrite(str(take / name / f"{number * 50_000_000}.png"), pair[eye])
    (take / "calibration.toml").write_text(CALIBRATION_TOML)
    return take


@pytest.fixture
def video(tmp_path, images):
    path = tmp_path / "take.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), 20.0, (128, 48))
    for left, right in images:
        writer.write(cv2.cvtColor(np.hstack([left, right]), cv2.COLOR_GRAY2BGR))
    writer.release()
    (tmp_path / "calibration.toml").write_text(CALIBRATION_TOML)
    return path


@pytest.mark.parametrize("kind", ["folder", "video"])
def test_pairs_come_back_in_order_with_their_times_and_can_be_read_again(kind, request, images):
    recording = open_recording(request.getfixturevalue(kind))
    assert len(recording) == N_PAIRS
    assert recording.calibration.baseline_m == 0.06
    for _ in range(2):
        frames = list(recording)
        stamps_ns = np.array([frame.stamp_ns for frame in frames])
        assert_array_equal(stamps_ns - stamps_ns[0], np.arange(N_PAIRS) * 50_000_000)
        tolerance = 0 if kind == "folder" else 1  # colour and back
        for eye in ("left", "right"):
            seen = np.array([getattr(frame, eye) for frame in frames], dtype=int)
            wanted = images[:, ("left", "right").index(eye)]
            assert np.abs(seen - wanted).max() <= tolerance


def test_names_that_are_no_stamps_keep_their_order(folder):
    for eye in ("left", "right"):
        for number, path in enumerate(sorted((folder / eye).iterdir(), key=lambda p: int(p.stem))):
            path.rename(path.with_name(f"frame_{number:03d}.png"))
    stamps_ns = [frame.stamp_ns for frame in open_recording(folder)]
    assert stamps_ns == sorted(set(stamps_ns))


@pytest.mark.parametrize("kind", ["folder", "video"])
def test_a_calibration_elsewhere_is_named_behind_the_path(kind, request, tmp_path):
    path = request.getfixturevalue(kind)
    place = (path if kind == "folder" else path.parent) / "calibration.toml"
    place.rename(tmp_path / "mine.toml")
    with pytest.raises(RecordingError, match=r"needs its camera's geometry.*\?calibration=FILE"):
        open_recording(path)
    named = f"{path}?calibration={tmp_path / 'mine.toml'}"
    assert len(open_recording(type(path)(named))) == N_PAIRS
    if kind == "folder":
        assert parse_camera(named) == RecordedSpec(type(path)(named))


def test_learning_takes_them(folder, video, tmp_path, capsys):
    words = ["--set", "learner.textons.training_images=2", "--json", str(tmp_path / "out.json")]
    assert main(["learn", str(folder), str(video), *words]) == 0
    assert "Frames read" in capsys.readouterr().out


def remove(path):
    path.unlink()


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda f: remove(f / "right" / "0.png"), RecordingError, r"1 of 12 .* first is left/0\.p"),
        (lambda f: [remove(p) for p in (f / "left").iterdir()], RecordingError, "holds no images"),
        (
            lambda f: cv2.imwrite(str(f / "left" / "0.png"), np.zeros((8, 8), np.uint8)),
            RecordingError,
            r"left/0\.png: image is 8 x 8; the calibration declares 64 x 48",
        ),
        (
            lambda f: (f / "calibration.toml").write_text("width = 3"),
            PlanError,
            r"calibration\.toml: width: unknown key",
        ),
    ],
)
def test_what_is_broken_is_named_in_one_line(folder, spoil, error, message):
    spoil(folder)
    with pytest.raises(error, match=message) as caught:
        list(open_recording(folder))
    assert "\n" not in str(caught.value)


def test_a_video_of_another_size_is_refused(video):
    place = video.parent / "calibration.toml"
    place.write_text(CALIBRATION_TOML.replace("width_px = 64", "width_px = 32"))
    with pytest.raises(RecordingError, match="sends 128x48 px; its calibration says 2 x 32x48"):
        open_recording(video)
