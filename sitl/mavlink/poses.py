"""Poses that another autopilot reports, whichever of its messages bring them."""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.clock import wall_s
from companion.kernel.frames import Quaternion, Vector3, quaternion_from_euler
from sitl.mavlink.listener import Listener
from sitl.mavlink.places import METRES_PER_DEGREE

WANTED_RATE_HZ = 50.0
ASK_PERIOD_S = 2.0
"""Wall time between two requests for poses while none come."""
SILENCE_LIMIT_S = 1.0
"""Wall time after which a source that has fallen silent gives way to a worse one."""


class Source(IntEnum):
    """Best first: a simulator's truth, a whole pose, a pose in two pieces."""

    HIL_STATE_QUATERNION = 0
    ODOMETRY = 1
    LOCAL_POSITION_NED = 2


class Report(NamedTuple):
    """Position, attitude or both, in the NED of where the vehicle's autopilot has its origin."""

    source: Source
    stamp_ns: int
    """The autopilot's clock."""
    position_ned_m: Vector3 | None
    ned_from_frd: Quaternion | None


class PoseListener:
    """Asks for poses and reads them; the best source that speaks is the one that counts."""

    def __init__(self, url: str) -> None:
        self._readers: dict[int, Callable[[mavlink.MAVLink_message], Report | None]] = {
            mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION: self._read_hil_state,
            mavlink.MAVLINK_MSG_ID_ODOMETRY: _read_odometry,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _read_local_position,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: _read_attitude,
        }
        self._listener = Listener(url, self._readers)
        self._origin_deg_m: Vector3 | None = None
        self._heard_wall_s = self._asked_wall_s = -math.inf
        self.source: Source | None = None

    @property
    def url(self) -> str:
        return self._listener.url

    def fileno(self) -> int:
        return self._listener.fileno()

    def receive(self) -> list[Report]:
        """What came since the last call, of one source only. Never blocks."""
        reports = []
        for message in self._listener.receive():
            report = self._readers[message.get_msgId()](message)
            if report is not None and _is_finite(report) and self._counts(report.source):
                self._heard_wall_s = wall_s()
                reports.append(report)
        self._ask_again()
        return [report for report in reports if report.source is self.source]

    def close(self) -> None:
        self._listener.close()

    def _counts(self, source: Source) -> bool:
        if self.source is None or source < self.source or self._silence_s() > SILENCE_LIMIT_S:
            self.source = source
        return source is self.source

    def _silence_s(self) -> float:
        return wall_s() - self._heard_wall_s

    def _ask_again(self) -> None:
        """Once an autopilot was heard, and later while it sends no poses."""
        waited_s = wall_s() - max(self._heard_wall_s, self._asked_wall_s)
        asked = self._asked_wall_s > -math.inf
        if self._listener.system_id is None or (asked and waited_s < ASK_PERIOD_S):
            return
        self._asked_wall_s = wall_s()
        for message_id in self._readers:
            self._listener.ask_for(message_id, WANTED_RATE_HZ)

    def _read_hil_state(self, message: mavlink.MAVLink_message) -> Report:
        """Degrees, relative to the first of them: the place where the vehicle was put."""
        here = message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3
        origin = self._origin_deg_m = self._origin_deg_m or here
        metres_per_degree_east = METRES_PER_DEGREE * math.cos(math.radians(origin[0]))
        position_ned_m = (
            (here[0] - origin[0]) * METRES_PER_DEGREE,
            (here[1] - origin[1]) * metres_per_degree_east,
            origin[2] - here[2],
        )
        w, x, y, z = message.attitude_quaternion
        stamp_ns = message.time_usec * 1000
        return Report(Source.HIL_STATE_QUATERNION, stamp_ns, position_ned_m, (w, x, y, z))


def _read_odometry(message: mavlink.MAVLink_message) -> Report | None:
    """Only in NED: a frame of its own would need a yaw that nobody knows here."""
    if message.frame_id != mavlink.MAV_FRAME_LOCAL_NED:
        return None
    w, x, y, z = message.q
    position_ned_m = message.x, message.y, message.z
    return Report(Source.ODOMETRY, message.time_usec * 1000, position_ned_m, (w, x, y, z))


def _read_local_position(message: mavlink.MAVLink_message) -> Report:
    position_ned_m = message.x, message.y, message.z
    return Report(Source.LOCAL_POSITION_NED, message.time_boot_ms * 1_000_000, position_ned_m, None)


def _read_attitude(message: mavlink.MAVLink_message) -> Report:
    attitude = quaternion_from_euler(message.roll, message.pitch, message.yaw)
    return Report(Source.LOCAL_POSITION_NED, message.time_boot_ms * 1_000_000, None, attitude)


def _is_finite(report: Report) -> bool:
    """Estimators that have not settled report NaN."""
    return all(map(math.isfinite, (*(report.position_ned_m or ()), *(report.ned_from_frd or ()))))
