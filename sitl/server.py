"""The world in real time: as fast as asked, on links and a camera socket."""

import errno
import logging
import select
from collections import deque
from collections.abc import Callable
from typing import Protocol

import zmq

from companion.kernel import wire
from companion.kernel.calibration import StereoCalibration
from companion.kernel.clock import wall_s
from companion.kernel.errors import PlanError, SimulatorError
from companion.kernel.messages import MocapPose, StereoFrame
from sitl.console import Console
from sitl.follower import Follower
from sitl.mavlink.poses import PoseListener
from sitl.mavlink.server import MavlinkServer
from sitl.pace import Pace

logger = logging.getLogger(__name__)

SHORTEST_WAIT_S = 0.001
"""Wall time. At high speed several steps share one wait; a datagram ends any wait at once."""
LONGEST_SLICE_S = 0.02
"""Wall time that the world may take before the links are served again."""
LONGEST_SILENCE_S = 1.2
"""Wall time without a heartbeat: clients time them on their own clocks, and heartbeats come once a
second of the world's."""
SEND_MEMORY_BYTES = 256_000_000
"""For one client that does not read; frames beyond it are dropped, for that client alone."""


class SteppedWorld(Protocol):
    """What the server needs of the simulated world."""

    @property
    def time_s(self) -> float: ...

    @property
    def crashed(self) -> str | None: ...

    @property
    def mocap(self) -> deque[MocapPose]: ...

    def step(self) -> None: ...


class ExposedCamera(Protocol):
    """Renders what the pair sees now."""

    def expose(self) -> StereoFrame | None:
        """None where the camera sends nothing."""
        ...


class CameraServer:
    """Publishes frames and motion-capture truth on a ZeroMQ PUB socket."""

    def __init__(self, url: str, calibration: StereoCalibration) -> None:
        self._calibration = calibration
        self._sequence = 0
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        image_bytes = 2 * calibration.width_px * calibration.height_px
        self._socket.setsockopt(zmq.SNDHWM, max(10, min(10_000, SEND_MEMORY_BYTES // image_bytes)))
        try:
            self._socket.bind(url)
        except zmq.ZMQError as error:
            self._context.destroy(linger=0)
            if error.errno in {errno.EADDRINUSE, errno.EADDRNOTAVAIL, errno.ENODEV}:
                raise SimulatorError(f"{url}: cannot publish frames: {error}") from error
            raise PlanError(
                f"{url}: not an address for frames ({error}); use tcp://HOST:PORT, port 0 for any"
            ) from error
        self.url = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def publish_frame(self, frame: StereoFrame) -> None:
        self._socket.send_multipart(wire.encode_frame(frame, self._sequence, self._calibration))
        self._sequence += 1

    def publish_truth(self, poses: deque[MocapPose]) -> None:
        """Takes all of ``poses``."""
        if poses:
            self._socket.send_multipart(wire.encode_truth(poses))
            poses.clear()

    def close(self) -> None:
        self._context.destroy(linger=0)


class RealTimeServer:
    """Steps the world at its pace; when that is too fast, the world is late, never jumps."""

    def __init__(
        self,
        world: SteppedWorld,
        camera: ExposedCamera,
        mavlink: MavlinkServer,
        frames: CameraServer,
        camera_rate_hz: float,
        pace: Pace,
        console: Console | None = None,
    ) -> None:
        self._world = world
        self._camera = camera
        self._mavlink = mavlink
        self._frames = frames
        self._frame_period_s = 1.0 / camera_rate_hz
        self._frame_due_s = world.time_s + self._frame_period_s
        self._pace = pace
        self._console = console
        self._reported_crash = False
        self._beat_s = world.time_s
        self._beat_wall_s = wall_s()

    def run(self, stopped: Callable[[], bool]) -> None:
        """Until ``stopped()``; it is asked every few milliseconds."""
        self._camera.expose()  # compiles what is compiled at first use, before time begins
        self._pace.start(self._world.time_s)
        while not stopped():
            self._mavlink.poll()
            if self._console is not None:
                self._console.poll()
            self._advance()
            self._keep_clients()
            wait_s = self._pace.wait_s(self._world.time_s)
            select.select(self._filenos(), [], [], max(SHORTEST_WAIT_S, wait_s) if wait_s else 0.0)

    def _filenos(self) -> list[int]:
        mine = self._console.filenos() if self._console is not None else []
        return [*self._mavlink.filenos(), *mine]

    def _advance(self) -> None:
        """All steps that are due, as far as one slice allows."""
        self._pace.give_up_lag(self._world.time_s)
        slice_end_s = wall_s() + LONGEST_SLICE_S
        while self._pace.due(self._world.time_s) and wall_s() < slice_end_s:
            self._step()
            self._pace.stepped()

    def _keep_clients(self) -> None:
        """So that a world that is slow or stands still does not look lost."""
        if self._world.time_s - self._beat_s >= 1.0:
            self._beat_s, self._beat_wall_s = self._world.time_s, wall_s()
        elif wall_s() - self._beat_wall_s > LONGEST_SILENCE_S:
            self._beat_wall_s = wall_s()
            self._mavlink.beat()

    def _step(self) -> None:
        self._world.step()
        time_s = self._world.time_s
        self._mavlink.update(time_s)
        if time_s >= self._frame_due_s - 1e-6:
            self._frame_due_s += self._frame_period_s
            frame = self._camera.expose()
            self._frames.publish_truth(self._world.mocap)
            if frame is not None:
                self._frames.publish_frame(frame)
            self._report_crash()

    def _report_crash(self) -> None:
        if self._world.crashed is not None and not self._reported_crash:
            self._reported_crash = True
            logger.warning("crashed: %s", self._world.crashed)


def follow(
    listener: PoseListener, follower: Follower, frames: CameraServer, stopped: Callable[[], bool]
) -> None:
    """Publishes what the room shows to a vehicle that flies elsewhere, until ``stopped()``."""
    while not stopped():
        select.select([listener], [], [], LONGEST_SLICE_S)
        for report in listener.receive():
            follower.take(report)
        seen = follower.look()
        frames.publish_truth(deque(seen.poses))
        for frame in seen.frames:
            frames.publish_frame(frame)
