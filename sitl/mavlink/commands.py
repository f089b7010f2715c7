"""What commands ask of the autopilot; those about messages are the link's.

A command that comes again, because the network doubled it, finds its wish fulfilled.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import Vector3
from companion.kernel.messages import NAN, FlightMode
from sitl.autopilot.interface import Ack, AutopilotPort, OrbitRequest, Severity
from sitl.mavlink.modes import requested_mode
from sitl.mavlink.places import ABOVE_HOME, Datum

Parameters = tuple[float, float, float, float, float, float, float]
"""param1 to param7 of COMMAND_LONG, or param1 to param4, x, y, z of COMMAND_INT; of a command with
a place north, east and down from the local origin in metres, in whatever frame it came."""

_FORCE: Final = 21196.0
"""MAVLink's magic number in param2 of COMPONENT_ARM_DISARM."""
_UNSET: Final = 2**31 - 1
"""Stands for NaN in x and y of COMMAND_INT."""

_WITH_PLACE: Final = {
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_DO_REPOSITION,
    mavlink.MAV_CMD_DO_ORBIT,
    mavlink.MAV_CMD_DO_SET_HOME,
}

REQUESTS: Final[Mapping[int, int]] = {
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION: mavlink.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION: (
        mavlink.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION
    ),
    mavlink.MAV_CMD_GET_HOME_POSITION: mavlink.MAVLINK_MSG_ID_HOME_POSITION,
}
"""Older commands that ask for one message, and which."""


def parameters_of(message: mavlink.MAVLink_message, datum: Datum) -> Parameters:
    m, placed = message, message.command in _WITH_PLACE
    first = (m.param1, m.param2, m.param3, m.param4)
    if m.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_INT:
        return (*first, *(_place(_frame(m), m.x, m.y, m.z, datum) if placed else (m.x, m.y, m.z)))
    if not placed:
        return (*first, m.param5, m.param6, m.param7)
    down_m = datum.down_m(mavlink.MAV_FRAME_GLOBAL, m.param7)
    return (*first, *datum.origin.level_m(m.param5, m.param6), down_m)


def whole(number: float) -> int:
    """What a float parameter says that stands for an id or a choice; -1 if it says nothing."""
    return round(number) if math.isfinite(number) else -1


def execute(autopilot: AutopilotPort, command: int, parameters: Parameters) -> Ack:
    handler = _HANDLERS.get(command)
    return Ack.UNSUPPORTED if handler is None else handler(autopilot, parameters)


def _frame(message: mavlink.MAVLink_message) -> int:
    """MAVSDK says "relative" of an orbit and means heights above the sea, as PX4 reads them."""
    orbit = message.command == mavlink.MAV_CMD_DO_ORBIT
    return int(mavlink.MAV_FRAME_GLOBAL if orbit and message.frame in ABOVE_HOME else message.frame)


def _place(frame: int, x: int, y: int, z: float, datum: Datum) -> Vector3:
    """NED of a COMMAND_INT's place."""
    down_m = datum.down_m(frame, z)
    if frame == mavlink.MAV_FRAME_LOCAL_NED:
        north_m, east_m = (NAN if value == _UNSET else value * 1e-4 for value in (x, y))
        return north_m, east_m, down_m
    latitude_deg, longitude_deg = (NAN if value == _UNSET else value * 1e-7 for value in (x, y))
    return (*datum.origin.level_m(latitude_deg, longitude_deg), down_m)


def _arm_or_disarm(autopilot: AutopilotPort, p: Parameters) -> Ack:
    force = p[1] == _FORCE
    if p[0] == 1.0:
        return autopilot.arm(force)
    return autopilot.disarm(force) if p[0] == 0.0 else Ack.DENIED


def _take_off(autopilot: AutopilotPort, p: Parameters) -> Ack:
    """NaN leaves the height to MIS_TAKEOFF_ALT; so does one below the ground, as in PX4.

    MAVProxy asks for such: it counts from the ground, not from the sea.
    """
    if not -math.inf < -p[6] <= 0.0:
        return autopilot.take_off(-p[6])
    height_m = autopilot.parameters["MIS_TAKEOFF_ALT"]
    autopilot.announce(Severity.CRITICAL, f"Using minimum takeoff altitude: {height_m:.2f} m")
    return autopilot.take_off()


def _land(autopilot: AutopilotPort, _: Parameters) -> Ack:
    return autopilot.land()


def _set_mode(autopilot: AutopilotPort, p: Parameters) -> Ack:
    mode = requested_mode(p[0], p[1], p[2])
    return Ack.DENIED if mode is None else autopilot.set_mode(mode)


def _terminate(autopilot: AutopilotPort, p: Parameters) -> Ack:
    if p[0] > 0.5:
        autopilot.terminate("commanded")
    return Ack.ACCEPTED


def _return_to_launch(autopilot: AutopilotPort, _: Parameters) -> Ack:
    return autopilot.set_mode(FlightMode.RTL)


def _hold(autopilot: AutopilotPort, _: Parameters) -> Ack:
    return autopilot.set_mode(FlightMode.HOLD)


def _start_mission(autopilot: AutopilotPort, p: Parameters) -> Ack:
    """From the item of param1 on, if that is one; arms on the ground."""
    first = 0 if not math.isfinite(p[0]) else int(p[0])
    if first > 0 and not autopilot.plans.mission.select(first):
        return Ack.DENIED
    ack = autopilot.set_mode(FlightMode.MISSION)
    return autopilot.arm() if ack is Ack.ACCEPTED else ack


def _set_mission_item(autopilot: AutopilotPort, p: Parameters) -> Ack:
    """param2 of 1 takes all jumps again, as selecting an item does here anyway."""
    known = math.isfinite(p[0]) and autopilot.plans.mission.select(int(p[0]))
    return Ack.ACCEPTED if known else Ack.DENIED


def _reposition(autopilot: AutopilotPort, p: Parameters) -> Ack:
    """param1: speed, or -1; param2: bit 0 leaves the mode of now for it; param4: heading."""
    change_mode = bool(max(0, whole(p[1])) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
    if not (change_mode or autopilot.status.mode is FlightMode.HOLD):
        return Ack.DENIED
    return autopilot.reposition(p[4:], p[3], p[0] if p[0] > 0.0 else NAN)


def _orbit(autopilot: AutopilotPort, p: Parameters) -> Ack:
    """param1: radius, clockwise if positive; param2: speed; param3: ORBIT_YAW_BEHAVIOUR."""
    return autopilot.orbit(OrbitRequest(p[0], p[1], whole(p[2]), p[4:]))


def _change_speed(autopilot: AutopilotPort, p: Parameters) -> Ack:
    """Speed over ground (or through air, which stands still): -1 no change, -2 the default."""
    no_change, default = -1.0, -2.0
    level = whole(p[0]) in {mavlink.SPEED_TYPE_AIRSPEED, mavlink.SPEED_TYPE_GROUNDSPEED}
    if not level or not (p[1] > 0.0 or p[1] in {no_change, default}):
        return Ack.DENIED
    return Ack.ACCEPTED if p[1] == no_change else autopilot.change_speed(max(p[1], 0.0) or NAN)


def _set_home(autopilot: AutopilotPort, p: Parameters) -> Ack:
    here = p[0] == 1.0
    return autopilot.set_home(None if here else p[4:])


def _inject_failure(autopilot: AutopilotPort, p: Parameters) -> Ack:
    """param3: which of several units, 0 for all."""
    instance = 0 if math.isnan(p[2]) else whole(p[2])
    return autopilot.inject_failure(whole(p[0]), whole(p[1]), instance)


def _no_actuator(_autopilot: AutopilotPort, _: Parameters) -> Ack:
    """Nothing but the rotors moves on this vehicle."""
    return Ack.DENIED


_HANDLERS: Mapping[int, Callable[[AutopilotPort, Parameters], Ack]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_or_disarm,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_LAND: _land,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return_to_launch,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: _hold,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_MISSION_START: _start_mission,
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: _set_mission_item,
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_DO_ORBIT: _orbit,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: _change_speed,
    mavlink.MAV_CMD_DO_SET_HOME: _set_home,
    mavlink.MAV_CMD_DO_SET_ACTUATOR: _no_actuator,
    mavlink.MAV_CMD_INJECT_FAILURE: _inject_failure,
}
