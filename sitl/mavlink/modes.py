"""PX4's numbers for modes and states, as measured on PX4 v1.17."""

import math

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.messages import FlightMode, LandedState

_AUTO = 4
_CUSTOM_MODES: dict[FlightMode, tuple[int, int]] = {
    FlightMode.MANUAL: (1, 0),
    FlightMode.ALTITUDE: (2, 0),
    FlightMode.POSITION: (3, 0),
    FlightMode.TAKEOFF: (_AUTO, 2),
    FlightMode.HOLD: (_AUTO, 3),
    FlightMode.MISSION: (_AUTO, 4),
    FlightMode.RTL: (_AUTO, 5),
    FlightMode.LAND: (_AUTO, 6),
    FlightMode.OFFBOARD: (6, 0),
    FlightMode.ORBIT: (3, 1),
}
"""(main, sub) mode of PX4's custom_mode."""

_MODES_BY_NUMBER = {
    numbers: mode for mode, numbers in _CUSTOM_MODES.items() if mode is not FlightMode.ORBIT
}
"""An orbit begins with DO_ORBIT, which tells where."""

_CUSTOM_FLAG = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
_STABILIZE = mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
_AUTO_FLAGS = mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | mavlink.MAV_MODE_FLAG_AUTO_ENABLED | _STABILIZE
_BASE_FLAGS: dict[FlightMode, int] = {
    FlightMode.MANUAL: mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | _STABILIZE,
    FlightMode.ALTITUDE: mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | _STABILIZE,
    FlightMode.POSITION: mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | _STABILIZE,
    FlightMode.OFFBOARD: _STABILIZE,
    FlightMode.ORBIT: _STABILIZE,
}

NON_STANDARD_MODE = 0
STANDARD_MODES: dict[FlightMode, int] = {
    FlightMode.POSITION: 1,
    FlightMode.ORBIT: 2,
    FlightMode.ALTITUDE: 4,
    FlightMode.RTL: 5,
    FlightMode.MISSION: 6,
    FlightMode.LAND: 7,
    FlightMode.TAKEOFF: 8,
}
"""MAV_STANDARD_MODE of those modes that have one."""

LANDED_STATES: dict[LandedState, int] = {
    LandedState.UNKNOWN: mavlink.MAV_LANDED_STATE_UNDEFINED,
    LandedState.ON_GROUND: mavlink.MAV_LANDED_STATE_ON_GROUND,
    LandedState.TAKING_OFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
    LandedState.IN_AIR: mavlink.MAV_LANDED_STATE_IN_AIR,
    LandedState.LANDING: mavlink.MAV_LANDED_STATE_LANDING,
}


def custom_mode(mode: FlightMode) -> int:
    main, sub = _CUSTOM_MODES.get(mode, (0, 0))
    return main << 16 | sub << 24


def base_mode(mode: FlightMode, armed: bool) -> int:
    flags: int = _CUSTOM_FLAG | _BASE_FLAGS.get(mode, _AUTO_FLAGS)
    return flags | mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else flags


def system_status(ready: bool, armed: bool, failsafe: bool) -> int:
    state = mavlink.MAV_STATE_STANDBY if ready else mavlink.MAV_STATE_UNINIT
    if armed:
        state = mavlink.MAV_STATE_CRITICAL if failsafe else mavlink.MAV_STATE_ACTIVE
    return int(state)


def requested_mode(base: float, main: float, sub: float) -> FlightMode | None:
    """The mode that DO_SET_MODE's first three parameters ask for; None when unknown."""
    if not (math.isfinite(base) and math.isfinite(main) and math.isfinite(sub)):
        return None
    if not int(base) & _CUSTOM_FLAG:
        return None
    return _MODES_BY_NUMBER.get((int(main), int(sub)))
