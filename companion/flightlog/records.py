"""What a log holds beside the kernel's messages: its topics, its header, its images and views.

A view is a second, well-known form of a record (schemas of foxglove.dev), written beside it so
that a viewer can draw poses and list events without being taught our record types.
"""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

import msgspec

from companion.kernel.calibration import StereoCalibration
from companion.kernel.messages import Event, MocapPose

METADATA_NAME = "flight"
_SQRT_HALF = math.sqrt(0.5)
_NS_PER_S = 1_000_000_000
_LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4, "critical": 5}


class Topic(StrEnum):
    """The topics of a flight; a log may hold others."""

    TELEMETRY = "/telemetry"
    PERCEPT = "/percept"
    MAP = "/map"
    DECISION = "/decision"
    TRUST = "/trust"
    SETPOINT = "/setpoint"
    MOCAP = "/mocap"
    EVENT = "/event"
    HEALTH = "/health"
    DRIFT = "/drift"
    LEFT = "/camera/left"
    RIGHT = "/camera/right"


class Record(Protocol):
    """Any msgspec Struct that knows its sensor time."""

    @property
    def stamp_ns(self) -> int: ...


class FlightMetadata(msgspec.Struct, frozen=True, kw_only=True):
    """The log's header: what was flown, and with what."""

    plan: dict[str, Any]
    """The effective plan, as TOML would hold it."""
    seed: int
    version: str
    """Of the companion."""
    calibration: StereoCalibration | None = None


class Time(msgspec.Struct, frozen=True):
    sec: int
    nsec: int


class CompressedImage(msgspec.Struct, frozen=True):
    """foxglove.CompressedImage; ``data`` travels as base64."""

    timestamp: Time
    frame_id: str
    data: bytes
    format: str


class Point(msgspec.Struct, frozen=True):
    x: float
    y: float
    z: float


class Orientation(msgspec.Struct, frozen=True):
    x: float
    y: float
    z: float
    w: float


class Pose(msgspec.Struct, frozen=True):
    position: Point
    orientation: Orientation


class PoseInFrame(msgspec.Struct, frozen=True):
    """foxglove.PoseInFrame: east, north, up of a body whose axes are forward, left, up."""

    timestamp: Time
    frame_id: str
    pose: Pose


class LogLine(msgspec.Struct, frozen=True):
    """foxglove.Log; the schema wants ``file`` and ``line`` too."""

    timestamp: Time
    level: int
    message: str
    name: str
    file: str = ""
    line: int = 0


class View(NamedTuple):
    """How a record type is shown: its own topic's suffix, the well-known type, the conversion."""

    suffix: str
    kind: type[msgspec.Struct]
    convert: Callable[[Any], msgspec.Struct]
    period_ns: int
    """No more than one view in this time: eyes need less than analysis."""


def split_time(stamp_ns: int) -> Time:
    return Time(*divmod(stamp_ns, _NS_PER_S))


def pose_view(record: MocapPose) -> PoseInFrame:
    """Viewers draw z up: NED becomes ENU, FRD becomes FLU."""
    north_m, east_m, down_m = record.truth_position_ned_m
    w, x, y, z = record.truth_ned_from_frd
    orientation = Orientation(
        x=_SQRT_HALF * (x + y), y=_SQRT_HALF * (x - y), z=_SQRT_HALF * (w - z),
        w=_SQRT_HALF * (w + z),
    )  # fmt: skip
    pose = Pose(Point(east_m, north_m, -down_m), orientation)
    return PoseInFrame(split_time(record.stamp_ns), "home", pose)


def event_view(record: Event) -> LogLine:
    level = _LEVELS.get(record.severity, 0)
    return LogLine(split_time(record.stamp_ns), level, record.text, "companion")


VIEWS: dict[type, View] = {
    MocapPose: View("/pose", PoseInFrame, pose_view, 50_000_000),
    Event: View("/log", LogLine, event_view, 0),
}

WELL_KNOWN: dict[type, str] = {
    CompressedImage: "foxglove.CompressedImage",
    PoseInFrame: "foxglove.PoseInFrame",
    LogLine: "foxglove.Log",
}
"""Schema names that viewers look for; any other type goes by its own name."""
