"""SET_POSITION_TARGET_LOCAL_NED to what the autopilot takes: NED, NaN where not controlled."""

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import Vector3, ned_from_hfrd, wrap_angle_rad
from companion.kernel.messages import NAN
from sitl.autopilot.interface import Estimate, OffboardSetpoint

_BODY_FRAMES = {mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED}
_OFFSET_FRAMES = {mavlink.MAV_FRAME_LOCAL_OFFSET_NED, *_BODY_FRAMES}
FRAMES = {mavlink.MAV_FRAME_LOCAL_NED, *_OFFSET_FRAMES}

_IGNORE_POSITION = (1, 2, 4)
_IGNORE_VELOCITY = (8, 16, 32)
_IGNORE_YAW = 1024
_IGNORE_YAW_RATE = 2048
_LARGEST = 1e6  # metres, metres per second, radians


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
    yaw_rad = _number(message.yaw, _IGNORE_YAW, mask)
    if frame in _BODY_FRAMES:
        position = _turned(position, estimate.yaw_rad)
        velocity = _turned(velocity, estimate.yaw_rad)
    if frame in _OFFSET_FRAMES:
        north_m, east_m, down_m = estimate.position_ned_m
        position = (position[0] + north_m, position[1] + east_m, position[2] + down_m)
    if frame == mavlink.MAV_FRAME_BODY_OFFSET_NED:
        yaw_rad = wrap_angle_rad(yaw_rad + estimate.yaw_rad)
    return OffboardSetpoint(
        position, velocity, yaw_rad, _number(message.yaw_rate, _IGNORE_YAW_RATE, mask)
    )


def _masked(vector: Vector3, bits: tuple[int, int, int], mask: int) -> Vector3:
    x, y, z = (_number(value, bit, mask) for value, bit in zip(vector, bits, strict=True))
    return x, y, z


def _number(value: float, ignore_bit: int, mask: int) -> float:
    """NaN, not controlled, where it is masked out or nothing that can be flown."""
    return value if not mask & ignore_bit and abs(value) < _LARGEST else NAN


def _turned(vector_hfrd: Vector3, yaw_rad: float) -> Vector3:
    north, east = ned_from_hfrd(vector_hfrd[0], vector_hfrd[1], yaw_rad)
    return north, east, vector_hfrd[2]
