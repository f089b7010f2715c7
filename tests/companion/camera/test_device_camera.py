"""Cameras that OpenCV opens, logs and recordings in a camera's place, and the words for them."""

import asyncio
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.camera.calibration_file import load_calibration
from companion.camera.device import DeviceStereoCamera, SideBySide, Stamps, VideoStereoCamera
from companion.camera.logged import LoggedRecording
from companion.camera.replay import ReplayCamera
from companion.camera.spec import (
    DeviceSpec,
    RecordedSpec,
    RemoteSpec,
    SimulatedSpec,
    VideoSpec,
    open_camera,
    parse_camera,
)
from companion.flightlog import FlightLogWriter, FlightMetadata
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.clock import SimClock, WallClock
from companion.kernel.errors import CameraError, PlanError, RecordingError
from companion.kernel.messages import StereoFrame

WIDTH_PX, HEIGHT_PX, RATE_HZ, N_FRAMES = 64, 48, 20.0, 6
EYE = Intrinsics(60.0, 60.0, 32.0, 24.0)
CALIBRATION = StereoCalibration(WIDTH_PX, HEIGHT_PX, EYE, EYE, 0.06)
CALIBRATION_TOML = """
width_px = 64
height_px = 48
baseline_m = 0.06
[left]
focal_x_px = 60
focal_y_px = 60
centre_x_px = 32
centre_y_px = 24
[right]
focal_x_px = 60
focal_y_px = 60
centre_x_px = 32
centre_y_px = 24
"""


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Lossless; the left eye of frame i has the grey level 10 i, the right eye 10 i + 100."""
    path = tmp_path_factory.mktemp("video") / "pair.avi"
    size = (2 * WIDTH_PX, HEIGHT_PX)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), RATE_HZ, size)
    for i in range(N_FRAMES):
        picture = np.full((HEIGHT_PX, 2 * WIDTH_PX, 3), 10 * i, np.uint8)
        picture[:, WIDTH_PX:] += 100
        writer.write(picture)
    writer.release()
    return path


@pytest.fixture
def calibration_file(tmp_path):
    path = tmp_path / "stereo.toml"
    path.write_text(CALIBRATION_TOML)
    return path


async def take(camera, count=None):
    async with camera:
        taken = []
        async for frame in camera.frames():
            taken.append(frame)
            if len(taken) == count:
                break
        return taken


def test_a_video_is_every_pair_in_order_with_its_own_stamps(video):
    camera = VideoStereoCamera(video, CALIBRATION, SimClock())
    frames = asyncio.run(take(camera))
    assert [frame.stamp_ns for frame in frames] == [i * 50_000_000 for i in range(N_FRAMES)]
    assert [int(frame.left.mean()) for frame in frames] == [10 * i for i in range(N_FRAMES)]
    assert [int(frame.right.mean()) for frame in frames] == [10 * i + 100 for i in range(N_FRAMES)]
    assert {frame.left.shape for frame in frames} == {(HEIGHT_PX, WIDTH_PX)}
    assert camera.frames_dropped == 0


def test_a_live_camera_gives_the_newest_frame_and_counts_the_others(video):
    """The consumer looks away until the source ended; then it sees the last frame only."""

    async def run():
        camera = DeviceStereoCamera(str(video), CALIBRATION, WallClock())
        async with camera:
            while camera.frames_dropped < N_FRAMES - 1:
                await WallClock().sleep(0.001)
            frames = camera.frames()
            newest = await anext(frames)
            with pytest.raises(CameraError, match="sends no more frames"):
                await anext(frames)
        return newest, camera.frames_dropped

    newest, dropped = asyncio.run(run())
    assert int(newest.left.mean()) == 10 * (N_FRAMES - 1)
    assert dropped == N_FRAMES - 1


def test_a_live_camera_can_be_left_at_any_time(video):
    frames = asyncio.run(take(DeviceStereoCamera(str(video), CALIBRATION, WallClock()), 1))
    assert len(frames) == 1


def test_a_driver_that_hangs_does_not_keep_the_camera_open(video, monkeypatch, caplog):
    answers, asked, read = threading.Event(), threading.Event(), SideBySide.read

    def hang(stream):
        if not hasattr(stream, "first"):  # it still opens
            return read(stream)
        asked.set()
        answers.wait(30.0)
        return None

    monkeypatch.setattr(SideBySide, "read", hang)
    monkeypatch.setattr("companion.camera.device.CLOSE_LIMIT_S", 0.05)
    camera = DeviceStereoCamera(str(video), CALIBRATION, WallClock())
    assert len(asyncio.run(take(camera, 1))) == 1
    assert asked.wait(10.0)
    assert "the driver hangs; left behind" in caplog.text
    answers.set()
    camera._thread.join()


@pytest.mark.parametrize("kind", [DeviceStereoCamera, VideoStereoCamera])
def test_another_geometry_is_refused_on_opening(video, kind):
    wide = StereoCalibration(320, 240, EYE, EYE, 0.06)
    source = str(video) if kind is DeviceStereoCamera else video
    expected = r"sends 128x48 px; its calibration says 2 x 320x240, which is 640x240 px"
    with pytest.raises(CameraError, match=expected):
        asyncio.run(take(kind(source, wide, SimClock())))


def test_what_cannot_be_opened_is_named(tmp_path):
    empty = tmp_path / "none.avi"
    with pytest.raises(CameraError, match=r"none.avi: cannot be opened"):
        asyncio.run(take(VideoStereoCamera(empty, CALIBRATION, SimClock())))


def test_stamps_are_the_captures_while_they_grow_then_the_clocks():
    clock = SimClock()
    clock.time_s = 100.0
    stamps = Stamps(clock)
    assert stamps.next_ns(5.0) == 5_000_000
    clock.time_s += 0.05
    assert stamps.next_ns(55.0) == 55_000_000
    clock.time_s += 0.04
    assert stamps.next_ns(55.0) == 95_000_000
    assert stamps.next_ns(400.0) == 95_000_001, "never back to the capture, never twice the same"


def test_a_log_with_images_is_a_recording(tmp_path):
    path = tmp_path / "flight.mcap"
    rng = np.random.default_rng(1)
    pairs = [rng.integers(0, 256, (2, HEIGHT_PX, WIDTH_PX), dtype=np.uint8) for _ in range(5)]
    metadata = FlightMetadata(plan={}, seed=1, version="0", calibration=CALIBRATION)
    with FlightLogWriter(path, metadata, images="stereo") as log:
        for i, pair in enumerate(pairs):
            log.write_frame(StereoFrame(i, *pair))
    recording = LoggedRecording(path)
    assert recording.calibration == CALIBRATION
    assert len(recording) == len(list(recording)) == 5
    replayed = asyncio.run(take(ReplayCamera(recording)))
    assert [frame.stamp_ns for frame in replayed] == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal([(f.left, f.right) for f in replayed], pairs)


def test_a_log_without_images_is_no_recording(tmp_path):
    path = tmp_path / "flight.mcap"
    metadata = FlightMetadata(plan={}, seed=1, version="0", calibration=CALIBRATION)
    FlightLogWriter(path, metadata).close()
    with pytest.raises(RecordingError, match=r"logged no images; fly with `images = \"stereo\"`"):
        LoggedRecording(path)


def test_a_replayed_pair_of_another_size_is_an_error():
    class Odd:
        calibration = CALIBRATION

        def __len__(self):
            return 1

        def __iter__(self):
            yield StereoFrame(7, np.zeros((4, 4), np.uint8), np.zeros((4, 4), np.uint8))

    with pytest.raises(CameraError, match=r"pair at 7 ns is \(4, 4\)"):
        asyncio.run(take(ReplayCamera(Odd())))


def test_the_words_for_cameras(video, calibration_file, tmp_path):
    geometry = f"?calibration={calibration_file}"
    assert parse_camera("sitl") == SimulatedSpec("sitl")
    assert parse_camera("tcp://10.0.0.2:5600") == RemoteSpec("tcp://10.0.0.2:5600")
    assert parse_camera(f"device:0{geometry}") == DeviceSpec(0, CALIBRATION)
    assert parse_camera(f"device:/dev/video2{geometry}") == DeviceSpec("/dev/video2", CALIBRATION)
    pipeline = "v4l2src ! videoconvert ! appsink"
    assert parse_camera(f"device:{pipeline}{geometry}") == DeviceSpec(pipeline, CALIBRATION)
    assert parse_camera(f"{video}{geometry}") == VideoSpec(video, CALIBRATION)
    assert parse_camera(str(tmp_path)) == RecordedSpec(tmp_path)


def test_words_open_their_cameras(video, calibration_file, tmp_path):
    """Whatever they name, frames come out of it."""
    path = tmp_path / "flight.mcap"
    metadata = FlightMetadata(plan={}, seed=1, version="0", calibration=CALIBRATION)
    with FlightLogWriter(path, metadata, images="stereo") as log:
        log.write_frame(StereoFrame(0, *np.zeros((2, HEIGHT_PX, WIDTH_PX), np.uint8)))
    geometry = f"?calibration={calibration_file}"
    for spec in (f"device:{video}{geometry}", f"{video}{geometry}", str(path)):
        (frame,) = asyncio.run(take(open_camera(spec, WallClock()), 1))
        assert frame.left.shape == (HEIGHT_PX, WIDTH_PX)


def test_a_recording_that_is_none_is_refused_before_the_flight(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nothing to see")
    with pytest.raises(RecordingError, match=r"notes.txt: not a recording"):
        open_camera(str(path), SimClock())


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        ("sitel", r"--camera sitel: no such file; allowed: sitl, tcp://HOST:PORT, device:N"),
        ("device:0", r"device:0: needs its geometry; append \?calibration=FILE"),
        ("device:0?calibration=missing.toml", r"missing.toml: no such file"),
    ],
)
def test_wrong_words_say_what_is_allowed(spec, text):
    with pytest.raises(PlanError, match=text):
        parse_camera(spec)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("baseline_m", "base_line_m", r"base_line_m: unknown key; did you mean 'baseline_m'\?"),
        ("baseline_m = 0.06", "baseline_m = 0.0", r"baseline_m: 0.0; must be above 0"),
        ("width_px = 64", 'width_px = "64"', r"width_px: Expected `int`"),
    ],
)
def test_a_wrong_calibration_names_the_key(calibration_file: Path, old, new, text):
    calibration_file.write_text(CALIBRATION_TOML.replace(old, new))
    with pytest.raises(PlanError, match=text):
        load_calibration(calibration_file)
