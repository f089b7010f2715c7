"""Items of the mission protocol: as they travel, and as the autopilot takes them."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple, Self

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import Vector3
from companion.kernel.messages import NAN
from sitl.autopilot.geofence import Area, Circle, LevelPoint, Polygon
from sitl.autopilot.mission import (
    ChangeSpeed,
    Delay,
    Jump,
    LandAt,
    MissionItem,
    PayloadAction,
    ReturnToLaunch,
    TakeOffTo,
    TurnTo,
    Waypoint,
)
from sitl.mavlink.places import ABOVE_HOME, ABOVE_SEA, Datum

GLOBAL_SCALE: Final = 1e7
"""Of degrees in MISSION_ITEM_INT."""
LOCAL_SCALE: Final = 1e4
"""Of metres in MISSION_ITEM_INT."""
_UNUSED_INT: Final = 0x7FFFFFFF

_LOCAL: Final = mavlink.MAV_FRAME_LOCAL_NED
_PLACED: Final = {*ABOVE_SEA, *ABOVE_HOME, _LOCAL}


class RejectedItemError(Exception):
    """Why an item is not taken; ``result`` is MAVLink's MAV_MISSION_RESULT."""

    def __init__(self, item: int, result: int, text: str) -> None:
        super().__init__(f"Item {item} rejected: {text}")
        self.result = result


class Item(NamedTuple):
    """An item of a mission, fence or rally list, in the units of MISSION_ITEM_INT.

    What it says in metres is in the local frame, whatever its own frame is.
    """

    number: int
    frame: int
    command: int
    autocontinue: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: int
    y: int
    z: float
    datum: Datum

    @classmethod
    def of(cls, message: mavlink.MAVLink_message, datum: Datum) -> Self:
        """From MISSION_ITEM_INT or the older MISSION_ITEM. Raises RejectedItemError."""
        m, x, y = message, message.x, message.y
        if m.get_msgId() == mavlink.MAVLINK_MSG_ID_MISSION_ITEM:
            scale = LOCAL_SCALE if m.frame == _LOCAL else GLOBAL_SCALE
            if not max(abs(x * scale), abs(y * scale)) < _UNUSED_INT:  # NaN as well
                raise RejectedItemError(
                    m.seq, mavlink.MAV_MISSION_INVALID_PARAM5_X, "place out of range"
                )
            x, y = round(x * scale), round(y * scale)
        parameters = (m.param1, m.param2, m.param3, m.param4)
        return cls(m.seq, m.frame, m.command, m.autocontinue, *parameters, x, y, m.z, datum)

    @property
    def level_m(self) -> LevelPoint:
        """North and east; NaN where the item names no place. Raises RejectedItemError."""
        point_m = self.fence_point_m
        unnamed = (self.x, self.y) == (0, 0) or _UNUSED_INT in (self.x, self.y)
        return (NAN, NAN) if unnamed and self.frame != _LOCAL else point_m

    @property
    def fence_point_m(self) -> LevelPoint:
        """The same of a fence, where 0, 0 is a place like any. Raises RejectedItemError."""
        if self.frame not in _PLACED:
            self.reject(mavlink.MAV_MISSION_UNSUPPORTED_FRAME, f"MAV_FRAME {self.frame}")
        if self.frame == _LOCAL:
            return self.x / LOCAL_SCALE, self.y / LOCAL_SCALE
        return self.datum.origin.level_m(self.x / GLOBAL_SCALE, self.y / GLOBAL_SCALE)

    @property
    def position_ned_m(self) -> Vector3:
        """NaN on the level where the item names no place. Raises RejectedItemError."""
        if not math.isfinite(self.z):
            self.reject(mavlink.MAV_MISSION_INVALID_PARAM7, "height not finite")
        return (*self.level_m, self.datum.down_m(self.frame, self.z))

    @property
    def place_ned_m(self) -> Vector3:
        """As ``position_ned_m``, of an item that must name one."""
        if math.isnan(self.level_m[0]):
            self.reject(mavlink.MAV_MISSION_INVALID_PARAM5_X, "names no place")
        return self.position_ned_m

    def at_least(self, number: int, lowest: float) -> float:
        """Parameter 1 to 4, which must be a number of this size. Raises RejectedItemError."""
        value = (self.param1, self.param2, self.param3, self.param4)[number - 1]
        if not lowest <= value < math.inf:
            result = mavlink.MAV_MISSION_INVALID_PARAM1 + number - 1
            self.reject(result, f"param{number} is {value:g}")
        return value

    def reject(self, result: int, text: str) -> None:
        raise RejectedItemError(self.number, result, text)


def mission_item(item: Item) -> MissionItem:
    """Raises RejectedItemError for what cannot be flown."""
    reader = _READERS.get(item.command)
    if reader is None:
        raise RejectedItemError(
            item.number, mavlink.MAV_MISSION_UNSUPPORTED, f"MAV_CMD {item.command} unknown"
        )
    return reader(item)


def _waypoint(item: Item) -> MissionItem:
    hold_s = _or_zero(item.param1) if item.autocontinue else math.inf
    radius_m = item.param2 if item.param2 > 0.0 else NAN
    return Waypoint(item.place_ned_m, hold_s, radius_m, _heading_rad(item.param4))


def _loiter(item: Item) -> MissionItem:
    return Waypoint(item.place_ned_m, math.inf, yaw_rad=_heading_rad(item.param4))


def _loiter_time(item: Item) -> MissionItem:
    return Waypoint(item.place_ned_m, item.at_least(1, 0.0))


def _take_off(item: Item) -> MissionItem:
    return TakeOffTo(item.position_ned_m, _heading_rad(item.param4))


def _land(item: Item) -> MissionItem:
    return LandAt(item.position_ned_m, _heading_rad(item.param4))


def _return(_: Item) -> MissionItem:
    return ReturnToLaunch()


def _change_speed(item: Item) -> MissionItem:
    """As PX4, what is not above 0 goes back to the usual speed."""
    return ChangeSpeed(item.param2 if 0.0 < item.param2 < math.inf else NAN)


def _delay(item: Item) -> MissionItem:
    return Delay(item.at_least(1, 0.0))


def _jump(item: Item) -> MissionItem:
    repeats = item.at_least(2, -1.0)
    return Jump(int(item.at_least(1, 0.0)), math.inf if repeats < 0.0 else repeats)


def _payload_action(item: Item) -> MissionItem:
    return PayloadAction(item.command)


def _turn(item: Item) -> MissionItem:
    relative = item.param4 == 1.0
    angle_deg = item.at_least(1, -360.0)
    counter_clockwise = relative and item.param3 < 0.0
    return TurnTo(math.radians(-angle_deg if counter_clockwise else angle_deg), relative)


_PAYLOAD_COMMANDS: Final = (
    mavlink.MAV_CMD_DO_SET_ROI,
    mavlink.MAV_CMD_DO_SET_ROI_LOCATION,
    mavlink.MAV_CMD_DO_SET_ROI_NONE,
    mavlink.MAV_CMD_DO_DIGICAM_CONTROL,
    mavlink.MAV_CMD_DO_MOUNT_CONFIGURE,
    mavlink.MAV_CMD_DO_MOUNT_CONTROL,
    mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE,
    mavlink.MAV_CMD_IMAGE_START_CAPTURE,
    mavlink.MAV_CMD_IMAGE_STOP_CAPTURE,
    mavlink.MAV_CMD_VIDEO_START_CAPTURE,
    mavlink.MAV_CMD_VIDEO_STOP_CAPTURE,
    mavlink.MAV_CMD_SET_CAMERA_MODE,
)
"""PX4 takes them in missions whatever is attached, so plans of camera drones can be flown."""

_READERS: Final[Mapping[int, Callable[[Item], MissionItem]]] = {
    mavlink.MAV_CMD_NAV_WAYPOINT: _waypoint,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: _loiter,
    mavlink.MAV_CMD_NAV_LOITER_TIME: _loiter_time,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_LAND: _land,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
    mavlink.MAV_CMD_NAV_DELAY: _delay,
    mavlink.MAV_CMD_CONDITION_DELAY: _delay,
    mavlink.MAV_CMD_CONDITION_YAW: _turn,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: _change_speed,
    mavlink.MAV_CMD_DO_JUMP: _jump,
    **dict.fromkeys(_PAYLOAD_COMMANDS, _payload_action),
}

_CIRCLES: Final[Mapping[int, bool]] = {
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False,
}
_VERTICES: Final[Mapping[int, bool]] = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}


def fence_areas(items: Sequence[Item]) -> tuple[Area, ...]:
    """Vertices follow each other, each with their number in param1. Raises RejectedItemError."""
    areas: list[Area] = []
    at = 0
    while at < len(items):
        item = items[at]
        if item.command in _CIRCLES:
            radius_m = item.at_least(1, 0.0)
            areas.append(Circle(item.fence_point_m, radius_m, _CIRCLES[item.command]))
            at += 1
        elif item.command in _VERTICES:
            vertices = _vertices(items[at:])
            outline_m = tuple(vertex.fence_point_m for vertex in vertices)
            areas.append(Polygon(outline_m, _VERTICES[item.command]))
            at += len(vertices)
        else:
            item.reject(mavlink.MAV_MISSION_UNSUPPORTED, f"MAV_CMD {item.command} is no fence")
    return tuple(areas)


def _vertices(items: Sequence[Item]) -> Sequence[Item]:
    """Those of the polygon that ``items`` begin with."""
    first = items[0]
    count = int(first.at_least(1, 3.0))
    vertices = items[:count]
    if len(vertices) < count or any(v.command != first.command for v in vertices):
        first.reject(mavlink.MAV_MISSION_INVALID_PARAM1, f"polygon lacks some of {count} vertices")
    return vertices


def rally_places(items: Sequence[Item]) -> tuple[Vector3, ...]:
    """On the floor. Raises RejectedItemError."""
    for item in items:
        if item.command != mavlink.MAV_CMD_NAV_RALLY_POINT:
            item.reject(
                mavlink.MAV_MISSION_UNSUPPORTED, f"MAV_CMD {item.command} is no rally point"
            )
    return tuple((*item.place_ned_m[:2], 0.0) for item in items)


def _or_zero(value: float) -> float:
    return value if value > 0.0 else 0.0


def _heading_rad(angle_deg: float) -> float:
    """NaN, which flies nose ahead, unless it is a number."""
    return math.radians(angle_deg) if math.isfinite(angle_deg) else NAN
