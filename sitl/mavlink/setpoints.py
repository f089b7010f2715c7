"""Setpoints and sticks to what the autopilot takes: NED, NaN where not controlled."""

import logging
import math
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import (
    Vector3,
    euler_from_quaternion,
    ned_from_hfrd,
    wrap_angle_rad,
)
from companion.kernel.messages import NAN
from sitl.autopilot.interface import (
    NAN3,
    AttitudeSetpoint,
    Estimate,
    ManualInput,
    OffboardSetpoint,
)
from sitl.mavlink.places import ABOVE_HOME, ABOVE_SEA, Datum, Earth

logger = logging.getLogger(__name__)

_BODY_FRAMES = {mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED}
_OFFSET_FRAMES = {mavlink.MAV_FRAME_LOCAL_OFFSET_NED, *_BODY_FRAMES}
FRAMES = frozenset({mavlink.MAV_FRAME_LOCAL_NED, *_OFFSET_FRAMES})
GLOBAL_FRAMES = ABOVE_SEA | ABOVE_HOME

_IGNORE_POSITION = (1, 2, 4)
_IGNORE_VELOCITY = (8, 16, 32)
_IGNORE_ACCELERATION = (64, 128, 256)
_IGNORE_YAW = 1024
_IGNORE_YAW_RATE = 2048
_IGNORE_RATES = (1, 2, 4)
_IGNORE_THRUST = 64
_IGNORE_ATTITUDE = 128
_NO_AXIS = 0x7FFF
# Of length 1 in theory; zeros are what clients send that forget it.
_SHORTEST_QUATERNION, _LONGEST_QUATERNION = 0.5, 2.0
_LARGEST = 1e6  # metres, metres per second and its square, radians, radians per second


class SetpointReader:
    """``read`` is None for a setpoint in an unknown frame; each such frame is logged once."""

    message_ids: Final = (
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
        mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
    )

    def __init__(self, earth: Earth) -> None:
        self._earth = earth
        self._unknown_frames: set[int] = set()

    def read(
        self, message: mavlink.MAVLink_message, estimate: Estimate
    ) -> OffboardSetpoint | AttitudeSetpoint | None:
        number = message.get_msgId()
        if number == mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET:
            return attitude_setpoint(message)
        if number == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT:
            frames, setpoint = GLOBAL_FRAMES, global_setpoint(message, self._earth.datum)
        else:
            frames, setpoint = FRAMES, offboard_setpoint(message, estimate)
        if setpoint is None and message.coordinate_frame not in self._unknown_frames:
            self._unknown_frames.add(message.coordinate_frame)
            logger.warning(
                "setpoints in MAV_FRAME %d are ignored; known frames: %s",
                message.coordinate_frame,
                ", ".join(map(str, sorted(frames))),
            )
        return setpoint


def offboard_setpoint(
    message: mavlink.MAVLink_message, estimate: Estimate
) -> OffboardSetpoint | None:
    """None for a frame that is not one of FRAMES.

    Body frames are turned by yaw only, as PX4 does. The position of an offset or body frame counts
    from where the vehicle is now; so does the yaw of BODY_OFFSET_NED.
    """
    frame, mask = message.coordinate_frame, message.type_mask
    if frame not in FRAMES:
        return None
    position = _masked((message.x, message.y, message.z), _IGNORE_POSITION, mask)
    velocity = _masked((message.vx, message.vy, message.vz), _IGNORE_VELOCITY, mask)
    acceleration = _masked((message.afx, message.afy, message.afz), _IGNORE_ACCELERATION, mask)
    yaw_rad = _number(message.yaw, _IGNORE_YAW, mask)
    if frame in _BODY_FRAMES:
        position = _turned(position, estimate.yaw_rad)
        velocity = _turned(velocity, estimate.yaw_rad)
        acceleration = _turned(acceleration, estimate.yaw_rad)
    if frame in _OFFSET_FRAMES:
        north_m, east_m, down_m = estimate.position_ned_m
        position = (position[0] + north_m, position[1] + east_m, position[2] + down_m)
    if frame == mavlink.MAV_FRAME_BODY_OFFSET_NED:
        yaw_rad = wrap_angle_rad(yaw_rad + estimate.yaw_rad)
    yaw_rate_rad_s = _number(message.yaw_rate, _IGNORE_YAW_RATE, mask)
    return OffboardSetpoint(position, velocity, yaw_rad, yaw_rate_rad_s, acceleration)


def global_setpoint(message: mavlink.MAVLink_message, datum: Datum) -> OffboardSetpoint | None:
    """SET_POSITION_TARGET_GLOBAL_INT; None for a frame that is not one of GLOBAL_FRAMES."""
    m, mask = message, message.type_mask
    if m.coordinate_frame not in GLOBAL_FRAMES:
        return None
    north_m, east_m = datum.origin.level_m(m.lat_int * 1e-7, m.lon_int * 1e-7)
    place = north_m, east_m, datum.down_m(m.coordinate_frame, m.alt)
    return OffboardSetpoint(
        _masked(place, _IGNORE_POSITION, mask),
        _masked((m.vx, m.vy, m.vz), _IGNORE_VELOCITY, mask),
        _number(m.yaw, _IGNORE_YAW, mask),
        _number(m.yaw_rate, _IGNORE_YAW_RATE, mask),
        _masked((m.afx, m.afy, m.afz), _IGNORE_ACCELERATION, mask),
    )


def attitude_setpoint(message: mavlink.MAVLink_message) -> AttitudeSetpoint:
    """SET_ATTITUDE_TARGET; angles that are ignored, or no rotation, leave the rates to fly."""
    mask = message.type_mask
    rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    usable = _SHORTEST_QUATERNION < math.hypot(*message.q) < _LONGEST_QUATERNION
    angles = NAN3 if mask & _IGNORE_ATTITUDE or not usable else euler_from_quaternion(message.q)
    rates_frd_rad_s = _masked(rates, _IGNORE_RATES, mask)
    given = not mask & _IGNORE_THRUST and math.isfinite(message.thrust)
    return AttitudeSetpoint(*angles, rates_frd_rad_s, message.thrust if given else 0.0)


def manual_input(message: mavlink.MAVLink_message) -> ManualInput:
    """MANUAL_CONTROL: thousandths; z from 0 to 1000 with 500 in the middle."""
    up_norm = 2.0 * _stick(message.z) - 1.0
    return ManualInput(_stick(message.x), _stick(message.y), up_norm, _stick(message.r))


def _stick(thousandths: int) -> float:
    """An axis that is not there, or out of range, is as good as centred or full."""
    return max(-1.0, min(1.0, thousandths / 1000.0)) if thousandths != _NO_AXIS else 0.0


def _masked(vector: Vector3, bits: tuple[int, int, int], mask: int) -> Vector3:
    x, y, z = (_number(value, bit, mask) for value, bit in zip(vector, bits, strict=True))
    return x, y, z


def _number(value: float, ignore_bit: int, mask: int) -> float:
    """NaN, not controlled, where it is masked out or nothing that can be flown."""
    return value if not mask & ignore_bit and abs(value) < _LARGEST else NAN


def _turned(vector_hfrd: Vector3, yaw_rad: float) -> Vector3:
    north, east = ned_from_hfrd(vector_hfrd[0], vector_hfrd[1], yaw_rad)
    return north, east, vector_hfrd[2]
