"""Stereo cameras and videos that OpenCV opens: both eyes side by side in one picture."""

import asyncio
import logging
import threading
from collections.abc import AsyncGenerator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.kernel.calibration import StereoCalibration
from companion.kernel.clock import Clock
from companion.kernel.errors import CameraError
from companion.kernel.messages import StereoFrame

CLOSE_LIMIT_S = 3.0
"""Wall time for a driver to return the frame that was asked for."""

logger = logging.getLogger(__name__)


class SideBySide:
    """A stream as stereo frames, left eye first; blocking, for one thread at a time.

    Raises CameraError when ``source`` cannot be opened, sends nothing or another geometry.
    """

    def __init__(
        self, name: str, source: int | str, calibration: StereoCalibration, clock: Clock
    ) -> None:
        self._name = name
        self._calibration = calibration
        self._stamps = Stamps(clock)
        backend = cv2.CAP_GSTREAMER if isinstance(source, str) and "!" in source else cv2.CAP_ANY
        self._capture = cv2.VideoCapture(source, backend)
        if not self._capture.isOpened():
            raise CameraError(f"{name}: cannot be opened as a camera or video by OpenCV")
        try:
            self.first = self.read()
            if self.first is None:
                raise CameraError(f"{name}: opens, but sends no frame")
        except CameraError:
            self.close()
            raise

    def read(self) -> StereoFrame | None:
        """The next pair; None at the end. Raises CameraError for another geometry."""
        found, picture = self._capture.read()
        if not found:
            return None
        stamp_ns = self._stamps.next_ns(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        width_px, height_px = self._calibration.width_px, self._calibration.height_px
        if picture.shape[:2] != (height_px, 2 * width_px):
            raise CameraError(
                f"{self._name}: sends {picture.shape[1]}x{picture.shape[0]} px; its calibration "
                f"says 2 x {width_px}x{height_px}, which is {2 * width_px}x{height_px} px"
            )
        grey = _grey(picture)
        left, right = np.hsplit(grey, 2)
        return StereoFrame(stamp_ns, np.ascontiguousarray(left), np.ascontiguousarray(right))

    def close(self) -> None:
        self._capture.release()


class Stamps:
    """Strictly growing stamps: the capture's own while they grow, from then on the clock's."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._trusts_capture = True
        self._position_ms = -1.0
        self._stamp_ns = 0
        self._offset_ns = 0

    def next_ns(self, position_ms: float) -> int:
        """The stamp of a frame that the capture places at ``position_ms``."""
        now_ns = round(self._clock.now_s() * 1e9)
        if self._trusts_capture and position_ms > self._position_ms:
            self._position_ms = position_ms
            self._stamp_ns = round(position_ms * 1e6)
            self._offset_ns = self._stamp_ns - now_ns
        else:
            self._trusts_capture = False
            self._stamp_ns = max(now_ns + self._offset_ns, self._stamp_ns + 1)
        return self._stamp_ns


class DeviceStereoCamera:
    """A live camera: a thread reads it all the time, the newest frame wins.

    ``source`` is an index, a device file or URL, or a GStreamer pipeline (a text with "!").
    """

    def __init__(self, source: int | str, calibration: StereoCalibration, clock: Clock) -> None:
        self.calibration = calibration
        self.frames_dropped = 0
        self._name = f"device:{source}"
        self._source = source
        self._clock = clock
        # A daemon: a driver that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._grab, name="camera", daemon=True)
        self._stopping = threading.Event()
        self._arrived = asyncio.Event()
        self._newest: StereoFrame | None = None
        self._failure: CameraError | None = None

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        self._stream = await asyncio.to_thread(
            SideBySide, self._name, self._source, self.calibration, self._clock
        )
        self._thread.start()
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stopping.set()
        await asyncio.to_thread(self._thread.join, CLOSE_LIMIT_S)
        if self._thread.is_alive():
            logger.warning("%s: the driver hangs; left behind", self._name)

    async def frames(self) -> AsyncGenerator[StereoFrame, None]:
        """Each newest frame once. Raises CameraError when the camera stops or sends other sizes."""
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            frame, self._newest = self._newest, None
            if frame is not None:
                yield frame
            if self._failure is not None and self._newest is None:
                raise self._failure

    def _grab(self) -> None:
        """The thread: hands every frame, and at last the failure, to the event loop."""
        frame = self._stream.first
        failure = CameraError(f"{self._name}: sends no more frames")
        try:
            while frame is not None and not self._stopping.is_set():
                self._loop.call_soon_threadsafe(self._offer, frame)
                frame = self._stream.read()
        except CameraError as error:
            failure = error
        finally:
            self._stream.close()
        with suppress(RuntimeError):  # a loop that has closed meanwhile left this thread behind
            self._loop.call_soon_threadsafe(self._fail, failure)

    def _offer(self, frame: StereoFrame) -> None:
        self.frames_dropped += self._newest is not None
        self._newest = frame
        self._arrived.set()

    def _fail(self, failure: CameraError) -> None:
        self._failure = failure
        self._arrived.set()


class VideoStereoCamera:
    """A video file: every frame in its turn, as fast as they are taken; none is dropped."""

    frames_dropped = 0

    def __init__(self, path: Path, calibration: StereoCalibration, clock: Clock) -> None:
        self.calibration = calibration
        self._path = path
        self._clock = clock

    async def __aenter__(self) -> Self:
        name = str(self._path)
        self._stream = SideBySide(name, name, self.calibration, self._clock)
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stream.close()

    async def frames(self) -> AsyncGenerator[StereoFrame, None]:
        """Ends with the file. Raises CameraError for frames of another size."""
        frame = self._stream.first
        while frame is not None:
            yield frame
            frame = self._stream.read()


def _grey(picture: NDArray[Any]) -> NDArray[np.uint8]:
    if picture.ndim == 3 and picture.shape[2] == 3:
        picture = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    return np.asarray(picture, dtype=np.uint8).reshape(picture.shape[:2])
