"""Folders in the EuRoC/ASL layout come back as they were written; broken ones are named."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from companion.camera.recording import open_recording, open_recordings
from companion.kernel.errors import RecordingError

STAMPS_NS = (2_000_000_000, 2_100_000_000, 2_200_000_000)
SHAPE = (24, 32)

SENSOR_YAML = """\
# a comment
sensor_type: camera
comment: "left: the one with the sticker"
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, {x_m},
         0.0, 1.0, 0.0, 0.0,   # rows go on
         0.0, 0.0, 1.0, 0.0,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 10
resolution: [32, 24]
camera_model: pinhole
intrinsics: [30.0, 31.0, {centre_x_px}, 12.5] # fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]
"""


@pytest.fixture
def images():
    rng = np.random.default_rng(0)
    return rng.integers(0, 256, (2, len(STAMPS_NS), *SHAPE)).astype(np.uint8)


@pytest.fixture
def folder(tmp_path, images):
    for eye, x_m, centre_x_px in ((0, 0.0, 16.0), (1, 0.06, 17.5)):
        root = tmp_path / "take" / "mav0" / f"cam{eye}"
        (root / "data").mkdir(parents=True)
        text = SENSOR_YAML.format(x_m=x_m, centre_x_px=centre_x_px)
        (root / "sensor.yaml").write_text(text)
        rows = ["#timestamp [ns],filename"]
        for stamp_ns, image in zip(STAMPS_NS, images[eye], strict=True):
            cv2.imwrite(str(root / "data" / f"{stamp_ns}.png"), image)
            rows.append(f"{stamp_ns},{stamp_ns}.png")
        # Out of order: a recording is in time order, whatever its index says.
        (root / "data.csv").write_text("\n".join([rows[0], *rows[:0:-1]]) + "\n")
    return tmp_path / "take"


def test_frames_come_in_time_order_as_they_were_written(folder, images):
    recording = open_recording(folder)
    frames = list(recording)
    assert len(recording) == len(frames) == len(STAMPS_NS)
    assert [frame.stamp_ns for frame in frames] == list(STAMPS_NS)
    assert_array_equal([frame.left for frame in frames], images[0])
    assert_array_equal([frame.right for frame in frames], images[1])


def test_a_recording_can_be_read_again_and_from_its_mav0_folder(folder):
    recording = open_recording(folder / "mav0")
    assert [f.stamp_ns for f in recording] == [f.stamp_ns for f in recording] == list(STAMPS_NS)


def test_calibration_comes_from_both_sensor_files(folder):
    calibration = open_recording(folder).calibration
    assert (calibration.width_px, calibration.height_px) == (32, 24)
    assert calibration.left.focal_y_px == 31.0
    assert calibration.left.distortion == (-0.28, 0.07, 0.0002, 1.8e-05)
    assert calibration.baseline_m == pytest.approx(0.06)
    assert calibration.disparity_at_infinity_px == pytest.approx(-1.5)
    assert_allclose(calibration.right_from_left, np.eye(3).ravel())


def test_eyes_mounted_at_an_angle_on_the_body_keep_their_baseline(folder):
    """Both eyes turned with the body: x of the camera along y of the body."""
    for eye, y_m in ((0, 0.1), (1, 0.16)):
        path = folder / "mav0" / f"cam{eye}" / "sensor.yaml"
        head, _, tail = path.read_text().partition("  data: [")
        rest = tail.partition("]\n")[2]
        pose = f"0.0, -1.0, 0.0, 0.3, 1.0, 0.0, 0.0, {y_m}, 0.0, 0.0, 1.0, 0.2, 0.0, 0.0, 0.0, 1.0"
        path.write_text(f"{head}  data: [{pose}]\n{rest}")
    calibration = open_recording(folder).calibration
    assert calibration.baseline_m == pytest.approx(0.06)
    assert_allclose(calibration.right_from_left, np.eye(3).ravel(), atol=1e-12)


def cut(path, size=None):
    data = path.read_bytes()
    path.write_bytes(data[: size or len(data) // 2])


def replace(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def damage(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))


CAM1 = "mav0/cam1"
PNG = f"{CAM1}/data/{STAMPS_NS[1]}.png"
YAML = f"{CAM1}/sensor.yaml"


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / YAML).unlink(), r"cam1/sensor\.yaml: missing.*calibration"),
        (lambda f: replace(f / YAML, "intrinsics", "intrinsic"), r"sensor\.yaml: intrinsics: miss"),
        (lambda f: replace(f / YAML, "[30.0,", "["), r"intrinsics: must be 4 numbers"),
        (lambda f: replace(f / YAML, "30.0", "wide"), r"intrinsics: must be 4 numbers"),
        (lambda f: replace(f / YAML, "30.0", "-30.0"), r"focal lengths must be above 0"),
        (lambda f: replace(f / YAML, "pinhole", "omni"), r"camera_model: omni; allowed: pinhole"),
        (lambda f: replace(f / YAML, "radial-tang", "equi"), r"distortion_model: equi.*allowed"),
        (lambda f: replace(f / YAML, "[32, 24]", "[64, 48]"), r"resolution is \(64, 48\)"),
        (lambda f: replace(f / YAML, "1.0, 0.0, 0.0, 0.06", "1, 0, 0, -0.06"), r"T_BS.*its right"),
        (lambda f: replace(f / YAML, "0.06", "nan"), r"T_BS\.data: must be 16 numbers"),
        (
            lambda f: replace(f / YAML, "pinhole", '{"a":' * 3000),
            r'camera_model: \{"a".*allowed: pinhole',
        ),
        (lambda f: (f / YAML).write_text("just words\n"), r"not KEY: VALUE: 'just words'"),
        (lambda f: (f / CAM1 / "data.csv").unlink(), r"cam1/data\.csv: cannot be read"),
        (lambda f: (f / CAM1 / "data.csv").write_text("#t,f\n"), r"data\.csv: lists no images"),
        (lambda f: (f / CAM1 / "data.csv").write_text("soon,x.png\n"), r"rows must be STAMP_NS"),
        (
            lambda f: replace(f / CAM1 / "data.csv", "2100000000,", "2100000001,"),
            r"2 of 4 stamps have only one eye; the first is 2100000000 in cam0",
        ),
        (lambda f: cut(f / PNG), r"2100000000\.png: PNG is truncated"),
        (lambda f: damage(f / PNG), r"2100000000\.png: PNG is truncated or damaged"),
        (lambda f: (f / PNG).unlink(), r"2100000000\.png: cannot be read"),
        (lambda f: (f / PNG).write_bytes(b""), r"2100000000\.png: not an image"),
        (lambda f: (f / PNG).write_text("no"), r"2100000000\.png: not an image"),
        (
            lambda f: cv2.imwrite(str(f / PNG), np.zeros((48, 64), np.uint8)),
            r"2100000000\.png: image is 64 x 48; sensor\.yaml declares 32 x 24",
        ),
    ],
)
def test_what_is_broken_is_named_in_one_line(folder, spoil, message):
    spoil(folder)
    with pytest.raises(RecordingError, match=message) as caught:
        list(open_recording(folder))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["nowhere", "notes.txt", "README"])
def test_what_is_no_recording_is_refused(tmp_path, name):
    if name != "nowhere":
        (tmp_path / name).write_text("words")
    with pytest.raises(RecordingError, match=name):
        open_recording(tmp_path / name)


def test_several_recordings_keep_the_order_given(folder):
    assert [len(r) for r in open_recordings([folder, folder / "mav0"])] == [3, 3]


def test_every_pair_of_the_stereo_boards_is_readable(stereoboard):
    recording = open_recording(stereoboard / "board1_take20")
    frames = list(recording)
    assert len(frames) == 103
    assert frames[0].left.shape == (96, 128)
    assert recording.calibration.disparity_at_infinity_px == -5.0
