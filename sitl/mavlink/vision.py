"""External vision: a client's poses and velocities as what the estimator takes."""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from companion.kernel.frames import Quaternion, quaternion_from_euler
from companion.kernel.messages import NAN
from sitl.autopilot.estimation.vision_sample import VisionSample

logger = logging.getLogger(__name__)

_MOCAP_NED: Final = 14
"""MAV_FRAME_MOCAP_NED, gone from MAVLink since; MAVSDK still says it."""
_NORTH_KNOWN: Final = {
    mavlink.MAV_FRAME_LOCAL_NED: True,
    _MOCAP_NED: True,
    mavlink.MAV_FRAME_LOCAL_FRD: False,
}
"""Frames of a pose, z down, and whether x points to north in them."""
_BODY: Final = {mavlink.MAV_FRAME_BODY_FRD, mavlink.MAV_FRAME_BODY_NED}
_POSE_DIAGONAL: Final = (0, 6, 11, 15, 18, 20)
"""Of the upper triangle of a 6 x 6 matrix, row by row."""
_SPEED_DIAGONAL: Final = (0, 4, 8)
_SHORTEST_QUATERNION, _LONGEST_QUATERNION = 0.5, 2.0


class VisionReader:
    """``read`` is None for what says nothing that can be used; odd frames are logged once."""

    def __init__(self) -> None:
        self._unknown_frames: set[int] = set()
        self._readers: Mapping[int, Callable[[mavlink.MAVLink_message], VisionSample | None]] = {
            mavlink.MAVLINK_MSG_ID_ODOMETRY: self._read_odometry,
            mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE: _read_position,
            mavlink.MAVLINK_MSG_ID_VISION_SPEED_ESTIMATE: _read_speed,
            mavlink.MAVLINK_MSG_ID_ATT_POS_MOCAP: _read_mocap,
        }
        self.message_ids = self._readers.keys()

    def read(self, message: mavlink.MAVLink_message) -> VisionSample | None:
        return self._readers[message.get_msgId()](message)

    def _read_odometry(self, m: mavlink.MAVLink_message) -> VisionSample | None:
        """Its velocity is used if it is along the vehicle's axes or in the frame of the pose."""
        if m.frame_id not in _NORTH_KNOWN:
            self._warn(m.frame_id)
            return None
        in_body = m.child_frame_id in _BODY
        usable = in_body or m.child_frame_id == m.frame_id
        north, east, down, _, _, yaw = _variances(m.pose_covariance, _POSE_DIAGONAL)
        v_x, v_y, v_z, *_ = _variances(m.velocity_covariance, _POSE_DIAGONAL)
        return VisionSample(
            _stamp_s(m.time_usec),
            position_m=(m.x, m.y, m.z),
            attitude=_attitude(m.q),
            velocity_m_s=(m.vx, m.vy, m.vz) if usable else (NAN, NAN, NAN),
            velocity_in_body=in_body,
            north_known=_NORTH_KNOWN[m.frame_id],
            position_variance_m2=(north, east, down),
            yaw_variance_rad2=yaw,
            velocity_variance_m2_s2=(v_x, v_y, v_z),
            reset_counter=m.reset_counter,
            quality_percent=m.quality,
        )

    def _warn(self, frame: int) -> None:
        if frame not in self._unknown_frames:
            self._unknown_frames.add(frame)
            known = ", ".join(map(str, sorted(_NORTH_KNOWN)))
            logger.warning("odometry in MAV_FRAME %d is ignored; known frames: %s", frame, known)


def _read_position(m: mavlink.MAVLink_message) -> VisionSample:
    north, east, down, _, _, yaw = _variances(m.covariance, _POSE_DIAGONAL)
    angles = m.roll, m.pitch, m.yaw
    return VisionSample(
        _stamp_s(m.usec),
        position_m=(m.x, m.y, m.z),
        attitude=quaternion_from_euler(*angles) if all(map(math.isfinite, angles)) else None,
        position_variance_m2=(north, east, down),
        yaw_variance_rad2=yaw,
        reset_counter=m.reset_counter,
    )


def _read_speed(m: mavlink.MAVLink_message) -> VisionSample:
    v_north, v_east, v_down = _variances(m.covariance, _SPEED_DIAGONAL)
    return VisionSample(
        _stamp_s(m.usec),
        velocity_m_s=(m.x, m.y, m.z),
        velocity_variance_m2_s2=(v_north, v_east, v_down),
        reset_counter=m.reset_counter,
    )


def _read_mocap(m: mavlink.MAVLink_message) -> VisionSample:
    north, east, down, _, _, yaw = _variances(m.covariance, _POSE_DIAGONAL)
    return VisionSample(
        _stamp_s(m.time_usec),
        position_m=(m.x, m.y, m.z),
        attitude=_attitude(m.q),
        position_variance_m2=(north, east, down),
        yaw_variance_rad2=yaw,
    )


def _stamp_s(stamp_us: int) -> float:
    return stamp_us * 1e-6 if stamp_us else NAN


def _attitude(q: Sequence[float]) -> Quaternion | None:
    """None for what is no rotation; scaled to length 1."""
    norm = math.hypot(*q)
    if not _SHORTEST_QUATERNION < norm < _LONGEST_QUATERNION:  # nor is NaN
        return None
    w, x, y, z = (value / norm for value in q)
    return w, x, y, z


def _variances(covariance: Sequence[float], diagonal: Sequence[int]) -> list[float]:
    """NaN in the first entry says that nothing is known, of any."""
    known = not math.isnan(covariance[0])
    return [covariance[place] if known else NAN for place in diagonal]
