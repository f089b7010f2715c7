"""A stereo camera in another process, over ZeroMQ; it brings motion capture where there is any."""

import asyncio
from collections.abc import AsyncGenerator
from types import TracebackType
from typing import Self, cast

import zmq
import zmq.asyncio

from companion.kernel import wire
from companion.kernel.calibration import StereoCalibration
from companion.kernel.errors import CameraError
from companion.kernel.messages import MocapPose, StereoFrame
from companion.kernel.settings import Settings

RECEIVE_HIGH_WATER = 10_000
"""Messages that may wait while the event loop is busy; truth must not be lost."""


class RemoteCameraSettings(Settings, frozen=True):
    """Limits in wall time: a socket knows no other."""

    open_limit_s: float = 5.0
    """How long to wait for the first frame."""
    silence_limit_s: float = 5.0
    """Without any message for this long, the server counts as gone."""


class RemoteCamera:
    """``StereoCamera`` and ``MotionCapture`` over one socket; the newest frame wins."""

    def __init__(self, url: str, settings: RemoteCameraSettings | None = None) -> None:
        self._url = url
        self._settings = settings or RemoteCameraSettings()
        self._calibration: StereoCalibration | None = None
        self._newest: wire.SentFrame | None = None
        self._arrived = asyncio.Event()
        self._poses: list[MocapPose] = []
        self._last_sequence: int | None = None
        self._frames_dropped = 0

    @property
    def calibration(self) -> StereoCalibration:
        if self._calibration is None:
            raise CameraError(f"{self._url}: not open; the first frame brings the calibration")
        return self._calibration

    @property
    def frames_dropped(self) -> int:
        return self._frames_dropped

    def drain(self) -> list[MocapPose]:
        """Truth since the last call, oldest first."""
        poses, self._poses = self._poses, []
        return poses

    async def frames(self) -> AsyncGenerator[StereoFrame, None]:
        """Each newest frame once; raises CameraError when the server falls silent."""
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            if self._receiver.done():
                self._receiver.result()  # raises what ended it
            if self._newest is not None:
                sent, self._newest = self._newest, None
                if self._last_sequence is not None:
                    self._frames_dropped += sent.sequence - self._last_sequence - 1
                self._last_sequence = sent.sequence
                yield sent.frame

    async def __aenter__(self) -> Self:
        self._context = zmq.asyncio.Context()
        try:
            self._socket = self._connect()
            await self._await_first_frame()
        except BaseException:
            self._context.destroy(linger=0)
            raise
        self._receiver = asyncio.create_task(self._receive(), name="remote camera")
        return self

    async def __aexit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._receiver.cancel()
        await asyncio.wait({self._receiver})
        self._context.destroy(linger=0)

    def _connect(self) -> zmq.asyncio.Socket:
        socket = self._context.socket(zmq.SUB)
        socket.setsockopt(zmq.RCVHWM, RECEIVE_HIGH_WATER)
        socket.setsockopt(zmq.MAXMSGSIZE, wire.MAX_IMAGE_BYTES)
        for topic in (wire.FRAME_TOPIC, wire.TRUTH_TOPIC):
            socket.setsockopt(zmq.SUBSCRIBE, topic)
        try:
            socket.connect(self._url)
        except zmq.ZMQError as error:
            raise CameraError(
                f"{self._url}: not a camera's address ({error}); use tcp://HOST:PORT"
            ) from error
        return socket

    async def _await_first_frame(self) -> None:
        limit_s = self._settings.open_limit_s
        try:
            async with asyncio.timeout(limit_s):
                while self._calibration is None:
                    await self._socket.poll()
                    self._take_all_waiting()
        except TimeoutError:
            raise CameraError(
                f"{self._url}: no stereo frames within {limit_s:g} s; is the camera server running?"
            ) from None

    async def _receive(self) -> None:
        """Empties the socket into the slot and the list until the server falls silent."""
        limit_s = self._settings.silence_limit_s
        try:
            while await self._socket.poll(round(limit_s * 1e3)):
                self._take_all_waiting()
            raise CameraError(
                f"{self._url}: no stereo frames for {limit_s:g} s; did the camera server stop?"
            )
        finally:
            self._arrived.set()

    def _take_all_waiting(self) -> None:
        newest: list[bytes] | None = None
        while (parts := self._next_waiting()) is not None:
            if parts[0] == wire.FRAME_TOPIC:
                newest = parts
            elif parts[0] == wire.TRUTH_TOPIC:
                self._poses.extend(wire.decode_truth(parts))
        if newest is not None:
            self._keep(wire.decode_frame(newest))

    def _next_waiting(self) -> list[bytes] | None:
        try:
            # Without blocking, the future is done when it is handed out.
            received = self._socket.recv_multipart(zmq.NOBLOCK)
            return cast("asyncio.Future[list[bytes]]", received).result()
        except zmq.Again:
            return None

    def _keep(self, sent: wire.SentFrame) -> None:
        if self._calibration is None:
            self._calibration = sent.calibration
        elif sent.calibration != self._calibration:
            expected, got = self._calibration, sent.calibration
            raise CameraError(
                f"{self._url}: the camera changed in flight: expected {expected}, got {got}"
            )
        self._newest = sent
        self._arrived.set()
