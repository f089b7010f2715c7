"""COMMAND_LONG and COMMAND_INT for the autopilot; those about messages are the server's."""

import math
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.messages import FlightMode
from sitl.autopilot.interface import Ack, AutopilotPort
from sitl.mavlink.modes import requested_mode
from sitl.mavlink.snapshot import HOME_AMSL_M

Parameters = tuple[float, float, float, float, float, float, float]
"""param1 to param7 of COMMAND_LONG, or param1 to param4, x, y, z of COMMAND_INT."""

_FORCE = 21196.0
"""MAVLink's magic number in param2 of COMPONENT_ARM_DISARM."""


def parameters_of(message: mavlink.MAVLink_message) -> Parameters:
    m = message
    first = (m.param1, m.param2, m.param3, m.param4)
    if message.get_msgId() == mavlink.MAVLINK_MSG_ID_COMMAND_INT:
        return (*first, m.x, m.y, m.z)
    return (*first, m.param5, m.param6, m.param7)


def execute(autopilot: AutopilotPort, command: int, parameters: Parameters) -> Ack:
    handler = _HANDLERS.get(command)
    return Ack.UNSUPPORTED if handler is None else handler(autopilot, parameters)


def _arm_or_disarm(autopilot: AutopilotPort, p: Parameters) -> Ack:
    force = p[1] == _FORCE
    if p[0] == 1.0:
        return autopilot.arm(force)
    return autopilot.disarm(force) if p[0] == 0.0 else Ack.DENIED


def _take_off(autopilot: AutopilotPort, p: Parameters) -> Ack:
    """param7 is above sea level; NaN leaves the height to MIS_TAKEOFF_ALT."""
    return autopilot.take_off(p[6] - HOME_AMSL_M)


def _land(autopilot: AutopilotPort, _: Parameters) -> Ack:
    return autopilot.land()


def _set_mode(autopilot: AutopilotPort, p: Parameters) -> Ack:
    mode = requested_mode(p[0], p[1], p[2])
    return Ack.DENIED if mode is None else autopilot.set_mode(mode)


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


_HANDLERS: Mapping[int, Callable[[AutopilotPort, Parameters], Ack]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm_or_disarm,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_LAND: _land,
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return_to_launch,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: _hold,
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_MISSION_START: _start_mission,
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: _set_mission_item,
}
