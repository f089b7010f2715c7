"""The room around another autopilot: what its camera sees, what its hull touches.

Poses come late and with jitter, but each carries the autopilot's own time. So a frame is exposed at
a fixed rate of *that* clock, and only once the poses before and after the exposure are there:
jitter changes when a frame comes, never what it shows. In a gap between poses nothing is exposed.
"""

import logging
import math
from collections.abc import Iterator
from typing import Final, NamedTuple, Protocol

import msgspec

from companion.kernel.calibration import StereoCalibration
from companion.kernel.frames import Vector3, euler_from_quaternion, matrix_from_euler
from companion.kernel.messages import MocapPose, StereoFrame
from sitl.arena.camera import StereoCameraModel
from sitl.arena.room import Room
from sitl.arena.track import Pose, PoseTrack
from sitl.hull import HULL_RADIUS_M, ContactCounter, Surfaces
from sitl.simulator import MOCAP_HZ

logger = logging.getLogger(__name__)

RESTART_NS: Final = 1_000_000_000
"""Stamps that fall back by more than this are those of an autopilot that has started again."""
_NS_PER_S: Final = 1_000_000_000


class Reported(Protocol):
    """A report of the autopilot; see ``sitl.mavlink.poses``."""

    @property
    def source(self) -> int: ...

    @property
    def stamp_ns(self) -> int: ...

    @property
    def position_ned_m(self) -> Vector3 | None: ...

    @property
    def ned_from_frd(self) -> tuple[float, float, float, float] | None: ...


class Visit(msgspec.Struct, frozen=True, kw_only=True):
    """What became of it: the last line that ``sitl arena`` prints."""

    frames: int
    frames_skipped: int
    """Exposures for which no pose is known, or that lie outside of the room."""
    collisions: int
    minimum_clearance_m: float | None
    source: str | None
    """The message that brought the poses last."""


class Seen(NamedTuple):
    """Poses of the hull at 100 Hz, and the frames exposed meanwhile."""

    poses: list[MocapPose]
    frames: list[StereoFrame]


class _Schedule:
    """Whole multiples of a period, each once, in order."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = _NS_PER_S / rate_hz
        self._next: int | None = None

    def restart(self) -> None:
        self._next = None

    def due(self, newest_ns: int) -> Iterator[int]:
        """Stamps up to ``newest_ns``; nothing before the first one asked for."""
        if self._next is None:
            self._next = math.ceil(newest_ns / self._period_ns)
        while (stamp_ns := round(self._next * self._period_ns)) <= newest_ns:
            self._next += 1
            yield stamp_ns


class Follower:
    """The autopilot's origin is the room's starting place; north is north."""

    def __init__(
        self,
        room: Room,
        camera: StereoCameraModel,
        surfaces: Surfaces,
        camera_rate_hz: float,
        rest_height_m: float,
    ) -> None:
        """``rest_height_m``: of the vehicle's centre above the floor, where it stands at z = 0."""
        north_m, east_m, floor_m = room.start_position_ned_m
        self._room_from_home_m: Vector3 = (north_m, east_m, floor_m - rest_height_m)
        self._bounds_ned_m = room.bounds_ned_m
        self._camera = camera
        self._surfaces = surfaces
        self._contacts = ContactCounter()
        self._exposures, self._captures = _Schedule(camera_rate_hz), _Schedule(MOCAP_HZ)
        self._track = PoseTrack()
        self._source: int | None = None
        self._frames = self._skipped = 0
        self._minimum_clearance_m = math.inf

    @property
    def calibration(self) -> StereoCalibration:
        return self._camera.calibration

    def take(self, report: Reported) -> None:
        newest_ns = self._track.newest_ns
        restarted = newest_ns is not None and report.stamp_ns < newest_ns - RESTART_NS
        if restarted or report.source != self._source:
            if restarted:
                logger.warning("the autopilot's clock fell back: it has started again")
            self._source = report.source
            self._track = PoseTrack()
            self._exposures.restart()
            self._captures.restart()
        self._track.add(report.stamp_ns, report.position_ned_m, report.ned_from_frd)

    def look(self) -> Seen:
        """All that is due by the newest report."""
        newest_ns = self._track.newest_ns
        if newest_ns is None:
            return Seen([], [])
        known = (self._pose_at(stamp_ns) for stamp_ns in self._captures.due(newest_ns))
        poses = [self._touch(pose) for pose in known if pose is not None]
        exposed = (self._expose(stamp_ns) for stamp_ns in self._exposures.due(newest_ns))
        return Seen(poses, [frame for frame in exposed if frame is not None])

    def visit(self, source: str | None) -> Visit:
        nearest_m = self._minimum_clearance_m
        return Visit(
            frames=self._frames,
            frames_skipped=self._skipped,
            collisions=self._contacts.count,
            minimum_clearance_m=nearest_m if math.isfinite(nearest_m) else None,
            source=source,
        )

    def _pose_at(self, stamp_ns: int) -> Pose | None:
        """In room coordinates."""
        pose = self._track.at(stamp_ns)
        if pose is None:
            return None
        north_m, east_m, down_m = (
            a + b for a, b in zip(pose.position_ned_m, self._room_from_home_m, strict=True)
        )
        return pose._replace(position_ned_m=(north_m, east_m, down_m))

    def _touch(self, pose: Pose) -> MocapPose:
        """Walls, ceiling and furniture; the floor is where it lands, as far as anybody can tell."""
        distance_m, _ = self._surfaces.nearest(pose.position_ned_m)
        clearance_m = distance_m - HULL_RADIUS_M
        self._minimum_clearance_m = min(self._minimum_clearance_m, clearance_m)
        if self._contacts.update(clearance_m):
            logger.warning("contact with the room at %.2f s", pose.stamp_ns * 1e-9)
        return MocapPose(
            stamp_ns=pose.stamp_ns,
            truth_position_ned_m=pose.position_ned_m,
            truth_ned_from_frd=pose.ned_from_frd,
            truth_clearance_m=clearance_m,
            truth_collisions=self._contacts.count,
        )

    def _expose(self, stamp_ns: int) -> StereoFrame | None:
        pose = self._pose_at(stamp_ns)
        if pose is None or not self._is_inside(pose.position_ned_m):
            self._skipped += 1
            return None
        self._frames += 1
        attitude = matrix_from_euler(*euler_from_quaternion(pose.ned_from_frd))
        return self._camera.render(pose.position_ned_m, attitude, stamp_ns)

    def _is_inside(self, position_ned_m: Vector3) -> bool:
        low, high = self._bounds_ned_m.tolist()
        return all(a < b < c for a, b, c in zip(low, position_ned_m, high, strict=True))
