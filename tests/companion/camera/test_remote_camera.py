"""The camera's socket: what is sent is what arrives, and what goes wrong is said in one line."""

import asyncio
import math

import msgspec
import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st

from companion.camera.remote import RemoteCamera, RemoteCameraSettings
from companion.kernel import wire
from companion.kernel.calibration import Intrinsics, StereoCalibration
from companion.kernel.errors import CameraError
from companion.kernel.messages import MocapPose, StereoFrame

EYE = Intrinsics(focal_x_px=10.0, focal_y_px=10.0, centre_x_px=3.5, centre_y_px=2.5)
CALIBRATION = StereoCalibration(width_px=8, height_px=6, left=EYE, right=EYE, baseline_m=0.06)
QUICK = RemoteCameraSettings(open_limit_s=2.0, silence_limit_s=0.2)


def a_frame(number, width_px=8, height_px=6):
    rng = np.random.default_rng(number)
    left, right = rng.integers(0, 256, (2, height_px, width_px), dtype=np.uint8)
    return StereoFrame(stamp_ns=number * 100_000_000, left=left, right=right)


def a_pose(number):
    return MocapPose(
        stamp_ns=number,
        truth_position_ned_m=(1.0, 2.0, -1.0),
        truth_ned_from_frd=(1.0, 0.0, 0.0, 0.0),
        truth_clearance_m=0.4,
        truth_collisions=0,
    )


class Publisher:
    """A camera server in the test's own thread."""

    def __init__(self):
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.bind("tcp://127.0.0.1:0")
        self.url = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self.sent = 0

    def frame(self, calibration=CALIBRATION):
        frame = a_frame(self.sent, calibration.width_px, calibration.height_px)
        self._socket.send_multipart(wire.encode_frame(frame, self.sent, calibration))
        self.sent += 1

    def truth(self, *numbers):
        self._socket.send_multipart(wire.encode_truth([a_pose(n) for n in numbers]))

    def raw(self, *parts):
        self._socket.send_multipart(parts)

    async def until(self, task):
        """Sends frames until ``task`` is done: a client that connects misses the first ones."""
        while not task.done():
            self.frame()
            await asyncio.wait({task}, timeout=0.005)

    def close(self):
        self._context.destroy(linger=0)


@pytest.fixture
def publisher():
    publisher = Publisher()
    yield publisher
    publisher.close()


async def opened(publisher, settings=QUICK):
    """An open camera that has taken all that was sent so far."""
    camera = RemoteCamera(publisher.url, settings)
    await publisher.until(asyncio.create_task(camera.__aenter__()))
    await newest(camera, publisher.sent - 1)
    return camera


async def newest(camera, number):
    """Yields until frame ``number`` is the one that comes."""
    async for frame in camera.frames():
        if frame.stamp_ns == number * 100_000_000:
            return frame
    raise AssertionError("a remote camera's frames end with an error only")


@given(number=st.integers(0, 1000), size=st.tuples(st.integers(1, 9), st.integers(1, 9)))
def test_a_frame_survives_the_wire(number, size):
    width_px, height_px = size
    calibration = msgspec.structs.replace(CALIBRATION, width_px=width_px, height_px=height_px)
    frame = a_frame(number, width_px, height_px)
    sent = wire.decode_frame(wire.encode_frame(frame, number, calibration))
    assert (sent.frame.stamp_ns, sent.sequence) == (frame.stamp_ns, number)
    assert sent.calibration == calibration
    np.testing.assert_array_equal(sent.frame.left, frame.left)
    np.testing.assert_array_equal(sent.frame.right, frame.right)
    sent.frame.left[:] = 0  # consumers get images of their own


@pytest.mark.parametrize("missing", [(), ("left",), ("right",), ("left", "right")])
def test_an_eye_that_sent_nothing_and_skew_survive_the_wire(missing):
    nothing = np.empty((0, 0), np.uint8)
    frame = msgspec.structs.replace(a_frame(1), skew_ns=-7, **dict.fromkeys(missing, nothing))
    sent = wire.decode_frame(wire.encode_frame(frame, 1, CALIBRATION)).frame
    assert sent.skew_ns == -7
    for eye in ("left", "right"):
        np.testing.assert_array_equal(getattr(sent, eye), getattr(frame, eye))


def test_truth_survives_the_wire():
    poses = [a_pose(1), a_pose(2)]
    assert wire.decode_truth(wire.encode_truth(poses)) == poses


def changed(parts, **fields):
    header = msgspec.msgpack.decode(parts[1]) | fields
    return [parts[0], msgspec.msgpack.encode(header), *parts[2:]]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: p[:3], "parts of a frame: expected 4, got 3"),
        (lambda p: [*p[:3], p[3][:-1]], "bytes of the right image: expected 48, got 47"),
        (lambda p: changed(p, version=2), "version: expected 1, got 2"),
        (lambda p: changed(p, width_px=16), "width_px as calibrated: expected 8, got 16"),
        (lambda p: changed(p, stamp_ns="soon"), "damaged header"),
        (lambda p: [p[0], b"\xff", *p[2:]], "damaged header"),
        (lambda p: [p[0], bytes(wire.MAX_HEADER_BYTES + 1), *p[2:]], "header of"),
    ],
)
def test_a_spoilt_frame_is_refused(spoil, message):
    parts = wire.encode_frame(a_frame(1), 1, CALIBRATION)
    with pytest.raises(CameraError, match=message):
        wire.decode_frame(spoil(parts))


def test_an_oversize_image_is_refused_before_it_is_copied():
    huge = msgspec.structs.replace(CALIBRATION, width_px=8192, height_px=8192)
    header = wire.FrameHeader(
        sequence=0, stamp_ns=0, width_px=8192, height_px=8192, calibration=huge
    )
    with pytest.raises(CameraError, match=r"image of 8192x8192 px; at most"):
        wire.decode_frame([wire.FRAME_TOPIC, msgspec.msgpack.encode(header), b"", b""])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"width_px": -8, "height_px": -6}, "calibration.width_px"),
        ({"width_px": 1 << 20}, "Expected `int` <= 8192"),
        ({"baseline_m": 0.0}, "baseline_m: 0.0; must be above 0"),
        ({"baseline_m": math.nan}, "baseline_m: nan; must be above 0"),
        ({"left": {"focal_x_px": -1.0}}, "focal_x_px: -1.0; must be above 0"),
        ({"right": {"centre_x_px": math.inf}}, "centre: .* must be finite"),
        ({"right_from_left": [math.nan] * 9}, "right_from_left: .* must be finite"),
    ],
)
def test_a_calibration_that_no_camera_has_is_refused(wrong, said):
    parts = wire.encode_frame(a_frame(1), 1, CALIBRATION)
    calibration = msgspec.to_builtins(CALIBRATION)
    for name, value in wrong.items():
        calibration[name] = calibration[name] | value if isinstance(value, dict) else value
    size = {name: calibration[name] for name in ("width_px", "height_px")}
    with pytest.raises(CameraError, match=f"damaged header: .*{said}"):
        wire.decode_frame(changed(parts, calibration=calibration, **size))


def test_frames_arrive_with_the_calibration(publisher):
    async def run():
        camera = await opened(publisher)
        assert camera.calibration == CALIBRATION
        publisher.frame()
        frame = await newest(camera, publisher.sent - 1)
        np.testing.assert_array_equal(frame.left, a_frame(publisher.sent - 1).left)
        await camera.__aexit__(None, None, None)

    asyncio.run(run())


def test_the_newest_frame_wins_and_drops_are_counted_but_truth_is_kept(publisher):
    async def run():
        camera = await opened(publisher)
        camera.drain()
        dropped_before = camera.frames_dropped
        for number in range(7):
            publisher.truth(2 * number, 2 * number + 1)
            publisher.frame()
        await newest(camera, publisher.sent - 1)
        assert camera.frames_dropped - dropped_before <= 6
        publisher.sent += 3  # three that never came
        publisher.frame()
        await newest(camera, publisher.sent - 1)
        assert camera.frames_dropped - dropped_before >= 3
        assert [pose.stamp_ns for pose in camera.drain()] == list(range(14))
        assert camera.drain() == []
        await camera.__aexit__(None, None, None)

    asyncio.run(run())


def test_no_server_is_said_in_one_line():
    async def run():
        async with RemoteCamera("tcp://127.0.0.1:9", RemoteCameraSettings(open_limit_s=0.1)):
            pass

    expected = r"^tcp://127.0.0.1:9: no stereo frames within 0.1 s; is the camera server running\?$"
    with pytest.raises(CameraError, match=expected):
        asyncio.run(run())


def test_a_bad_address_is_said_in_one_line():
    async def run():
        async with RemoteCamera("nonsense"):
            pass

    with pytest.raises(CameraError, match="not a camera's address"):
        asyncio.run(run())


def test_a_server_that_dies_ends_the_frames(publisher):
    async def run():
        camera = await opened(publisher)
        publisher.close()
        try:
            await newest(camera, -1)
        finally:
            await camera.__aexit__(None, None, None)

    with pytest.raises(CameraError, match=r"no stereo frames for 0.2 s; did the camera server"):
        asyncio.run(run())


def test_another_geometry_in_flight_is_refused(publisher):
    async def run():
        camera = await opened(publisher)
        publisher.frame(msgspec.structs.replace(CALIBRATION, width_px=4))
        try:
            await newest(camera, -1)
        finally:
            await camera.__aexit__(None, None, None)

    with pytest.raises(CameraError, match=r"expected .*width_px=8.* got .*width_px=4"):
        asyncio.run(run())
